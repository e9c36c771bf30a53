//! The surface spanned by the observations: depth interpolated between them, without the image.
//!
//! A plane that a pinhole camera sees is linear in inverse depth. So between the observations, inverse depth is
//! interpolated linearly over their Delaunay triangulation. The confidence in a triangle depends on how well its
//! neighbours continue it: on a surface they lie in one plane, across an edge they do not. The field then expects the step
//! of the surface between two neighbouring pixels, times this confidence t, instead of none, and the basis functions the
//! rest:
//!
//! > sum over neighbours c_ij (z_i - z_j - t_ij (D_i - D_j) - (1 - t_ij) a (f_i - f_j))^2
//!
//! where z is depth, D the surface, f the sum of basis functions and cosines, and a the weight of their steps: 1 far from
//! all observations, where nothing else predicts the scene, and less between and beside many. This changes the right-hand
//! side of the equations alone. Without it, a slope between two observations is flattened where the image is uniform, and
//! concentrated at the edges of its texture.
//!
//! Where the equations are factorised with the observations in them, they also follow perspective: affinities are higher
//! where the confidence is high, whatever the image shows there, and the variance of a step, like that of the error of an
//! observation, grows in proportion to depth. (In proportion to its square, relative errors would be smaller, and the root
//! mean square of errors larger.)

use crate::field::Grid;
use crate::fit::medians::median;
use delaunator::{EMPTY, Point, Triangulation, next_halfedge, triangulate};
use lsdc_kernels::schedule::InTasks;
use rayon::prelude::*;

/// Distance of a triangle from the planes of its neighbours, relative to depth, that halves the confidence in it. This constant
/// and the next five were chosen on frames of five outdoor scanners and of 20 sets of depth cameras, including NYU's training
/// frames.
const HINGE: f64 = 0.01;
/// Logarithm of the ratio of the farthest to the nearest corner that halves the confidence.
const SPREAD: f64 = 0.3;
/// Increase of the affinity of two pixels at full confidence: the affinity in a uniform image.
const FIRM: f64 = 1.0;
/// Exponent of the confidence in this increase.
const FALL: i32 = 8;
/// The weight of the steps of basis functions near many observations, between and beyond them. With few observations it
/// is 1: on NYU's frames with 5 points, half of it would raise the RMSE by 18 %.
const WITHIN: f64 = 0.75;
const BEYOND: f64 = 0.5;
/// The weight is 1 up to this number of observations, and as above from this number on.
const FEW: f64 = 50.0;
const MANY: f64 = 500.0;
/// Width of a gap between observations, relative to the usual width, at which it counts as half wide: far from all
/// observations, only basis functions predict the scene. Chosen on ten sets of depth cameras and six of laser scanners; from 2
/// to 6, errors change by less than 1.5 %.
const GAP: f64 = 4.0;

/// Pixels per task.
const TOGETHER: usize = 1 << 12;

/// Depth between observations at every pixel.
pub(super) struct Surface {
    /// Depths; outside the triangulation, those of the nearest pixel inside.
    depths: Vec<f64>,
    /// Confidence from 0 to 1; NaN outside the triangulation.
    confidence: Vec<f64>,
    /// From 1 at the usual density of observations to 0 in wide gaps and far outside.
    narrow: Vec<f64>,
    /// The weight of the steps of basis functions in narrow gaps and close beyond the observations.
    within: f64,
    beyond: f64,
    /// The mean depth of the observations.
    mean: f64,
    /// The usual width of a gap between observations, in pixels.
    usual_gap: f64,
}

/// The prediction of an observation by the surface of the others.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeftOut {
    /// The depth of the surface of the others there.
    pub(super) depth: f64,
    /// The confidence in it.
    pub(super) confidence: f64,
}

impl Surface {
    /// Returns the surface through depths above 0 at positions (u, v) on a grid of `size` (height, width). Depths with a
    /// `firmness` below 1 reduce the confidence in the triangles around them. `None` if they span no triangle.
    pub(super) fn through(
        places: &[[f64; 2]],
        depths: &[f64],
        firmness: &[f64],
        size: (usize, usize),
    ) -> Option<Self> {
        let mesh = Mesh::new(places, depths, firmness)?;
        let mut found = Self {
            depths: vec![0.0; size.0 * size.1],
            confidence: vec![f64::NAN; size.0 * size.1],
            narrow: vec![1.0; size.0 * size.1],
            within: basis_weight(WITHIN, depths.len()),
            beyond: basis_weight(BEYOND, depths.len()),
            mean: depths.iter().sum::<f64>() / depths.len() as f64,
            usual_gap: mesh.usual_gap(),
        };
        let wide = GAP * found.usual_gap;
        let narrow = |gap: f64| 1.0 / (1.0 + (gap / wide).powi(2));
        let triangles = mesh.planes.iter().zip(&mesh.confidence).zip(&mesh.gaps);
        for ((plane, confidence), gap) in triangles {
            let Some(plane) = plane else { continue };
            let narrow = narrow(*gap);
            plane.fill(size, |pixel, inverse| {
                found.depths[pixel] = inverse.recip();
                found.confidence[pixel] = *confidence;
                found.narrow[pixel] = narrow;
            });
        }
        let distances = continue_outside(&mut found.depths, size);
        let pixels = found.narrow.iter_mut().zip(distances);
        for (value, distance) in pixels.filter(|(_, distance)| *distance > 0.0) {
            // The middle of a gap is half its width away from the observations next to it.
            *value = narrow(2.0 * f64::from(distance));
        }
        // Observations may span less than a pixel.
        found
            .depths
            .iter()
            .all(|depth| *depth > 0.0)
            .then_some(found)
    }

    /// Returns the depth at every pixel with the narrowness of the gap between observations there, from 1 to 0; `None` outside
    /// the triangulation.
    pub(super) fn inside(&self) -> impl Iterator<Item = Option<(f64, f64)>> {
        let pixels = self.depths.iter().zip(&self.narrow).zip(&self.confidence);
        pixels.map(|((depth, narrow), confidence)| {
            (!confidence.is_nan()).then_some((*depth, *narrow))
        })
    }

    /// Returns the depth at every pixel of a grid of `size`, with a share that rises from 0 at the outline of the triangulation to
    /// 1 within the usual gap; `None` outside.
    pub(super) fn up_to_outline(
        &self,
        size: (usize, usize),
    ) -> impl Iterator<Item = Option<(f64, f64)>> {
        let outside = self.confidence.iter();
        let mut outside: Vec<f64> = outside.map(|c| f64::from(u8::from(c.is_nan()))).collect();
        let distances = continue_outside(&mut outside, size);
        let pixels = self.depths.iter().zip(distances).zip(&self.confidence);
        pixels.map(|((depth, distance), confidence)| {
            let share = (f64::from(distance) / self.usual_gap).min(1.0);
            (!confidence.is_nan()).then_some((*depth, share))
        })
    }

    /// Returns the right-hand sides of the expected steps: in the equations of the field that is added to basis functions,
    /// whose values at every pixel are `functions`, and in those of the field alone.
    pub(super) fn right_sides(&self, grid: &Grid<'_>, functions: &[f32]) -> Vec<[f64; 2]> {
        self.divergence(grid, |one, other| {
            let functions = f64::from(functions[other]) - f64::from(functions[one]);
            let (expected, basis_weight) = self.expected(one, other);
            [expected + basis_weight * functions - functions, expected]
        })
    }

    /// Like [`Self::right_sides`], for the field alone.
    pub(super) fn right_side(&self, grid: &Grid<'_>) -> Vec<[f64; 1]> {
        self.divergence(grid, |one, other| [self.expected(one, other).0])
    }

    /// The step of the surface between two pixels, times the confidence in it, and the weight of a step of basis functions.
    fn expected(&self, one: usize, other: usize) -> (f64, f64) {
        match self.confidence(one, other) {
            None => (0.0, self.basis_weight(self.beyond, one, other)),
            Some(confidence) => {
                let step = self.depths[other] - self.depths[one];
                let basis_weight = self.basis_weight(self.within, one, other);
                (confidence * step, (1.0 - confidence) * basis_weight)
            }
        }
    }

    /// The weight of a step of basis functions between two pixels, from that in a narrow gap.
    fn basis_weight(&self, narrow: f64, one: usize, other: usize) -> f64 {
        1.0 - (1.0 - narrow) * self.narrow[one].min(self.narrow[other])
    }

    /// The sum of the steps between neighbours, times their affinities, at every pixel.
    fn divergence<const B: usize>(
        &self,
        grid: &Grid<'_>,
        step: impl Fn(usize, usize) -> [f64; B] + Sync,
    ) -> Vec<[f64; B]> {
        let [right, down] = self.of_pairs(grid, |one, other, affinity| {
            step(one, other).map(|step| affinity * step)
        });
        let width = grid.width;
        let at = |i: usize| {
            std::array::from_fn(|b| {
                let before = if i.is_multiple_of(width) {
                    0.0
                } else {
                    right[i - 1][b]
                };
                let above = if i >= width { down[i - width][b] } else { 0.0 };
                before + above - right[i][b] - down[i][b]
            })
        };
        self.of_pixels([0.0; B], at)
    }

    /// Affinities in perspective, with the right neighbour and with the one below.
    pub(super) fn affinities(&self, grid: &Grid<'_>) -> [Vec<f64>; 2] {
        let pairs = self.of_pairs(grid, |one, other, affinity| {
            let confidence = self.confidence(one, other).unwrap_or(0.0);
            let farther = self.depths[one].max(self.depths[other]);
            [(affinity + FIRM * confidence.powi(FALL)) * (self.mean / farther)]
        });
        pairs.map(Vec::into_flattened)
    }

    /// The inverse of the variance of the error of an observation at a depth, over that at the mean depth.
    pub(super) fn precision(&self, depth: f64) -> f64 {
        self.mean / depth
    }

    /// The confidence in the step between two pixels, if both are inside of the triangulation.
    fn confidence(&self, one: usize, other: usize) -> Option<f64> {
        let (one, other) = (self.confidence[one], self.confidence[other]);
        (!one.is_nan() && !other.is_nan()).then(|| one.min(other))
    }

    fn of_pixels<T: Copy + Send>(&self, none: T, of: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let mut values = vec![none; self.depths.len()];
        let parts = values.par_chunks_mut(TOGETHER).enumerate();
        parts.each(|(i, part)| {
            let places = part.iter_mut().zip(i * TOGETHER..);
            places.for_each(|(value, pixel)| *value = of(pixel));
        });
        values
    }

    /// The values of `of` for each pixel, its right neighbour and their affinity, and for each and the one below; 0 where
    /// there is none.
    fn of_pairs<const B: usize>(
        &self,
        grid: &Grid<'_>,
        of: impl Fn(usize, usize, f64) -> [f64; B] + Sync,
    ) -> [Vec<[f64; B]>; 2] {
        let none = [0.0; B];
        let right = |one: usize| {
            let is_last = (one + 1).is_multiple_of(grid.width);
            (!is_last).then(|| of(one, one + 1, grid.right[one]))
        };
        let down = |one: usize| {
            let other = one + grid.width;
            (other < self.depths.len()).then(|| of(one, other, grid.down[one]))
        };
        [
            self.of_pixels(none, |one| right(one).unwrap_or(none)),
            self.of_pixels(none, |one| down(one).unwrap_or(none)),
        ]
    }
}

/// Returns the weight of the steps of basis functions, from 1 for few observations to `least` for many, by the logarithm of
/// their number.
fn basis_weight(least: f64, count: usize) -> f64 {
    let place = (count as f64 / FEW).ln() / (MANY / FEW).ln();
    1.0 - (1.0 - least) * place.clamp(0.0, 1.0)
}

/// The prediction of each observation by the surface of the others, if it is inside of their triangulation.
pub(super) fn left_out(
    places: &[[f64; 2]],
    depths: &[f64],
    firmness: &[f64],
) -> Vec<Option<LeftOut>> {
    let Some(mesh) = Mesh::new(places, depths, firmness) else {
        return vec![None; places.len()];
    };
    // An edge that ends at each observation.
    let mut edges = vec![EMPTY; places.len()];
    for edge in 0..mesh.triangulation.triangles.len() {
        edges[mesh.triangulation.triangles[next_halfedge(edge)]] = edge;
    }
    let one = |observation: usize, &edge: &usize| {
        let (ring, confidence) = mesh.around(edge)?;
        // Without an observation, its neighbours have the Delaunay triangulation of these points alone, because no other
        // observation is in their circumcircles.
        let own: Vec<[f64; 2]> = ring.iter().map(|&other| places[other]).collect();
        let points: Vec<Point> = own.iter().map(|&[x, y]| Point { x, y }).collect();
        let found = triangulate(&points).triangles;
        let inverse: Vec<f64> = ring.iter().map(|&other| depths[other].recip()).collect();
        let planes = found.chunks_exact(3);
        let mut planes = planes.filter_map(|c| Plane::through([c[0], c[1], c[2]], &own, &inverse));
        let plane = planes.find(|plane| plane.contains(places[observation]))?;
        let depth = plane.at(places[observation]).recip();
        Some(LeftOut { depth, confidence })
    };
    of_all(&edges, one)
}

/// Computes a value from each item and its index, with many items per task.
fn of_all<T: Sync, R: Send>(items: &[T], of: impl Fn(usize, &T) -> R + Sync) -> Vec<R> {
    /// Items of a task.
    const MANY: usize = 1 << 8;
    let parts: Vec<Vec<R>> = items.par_chunks(MANY).enumerate().gather(|(part, items)| {
        let own = (part * MANY..).zip(items);
        own.map(|(i, item)| of(i, item)).collect()
    });
    parts.into_iter().flatten().collect()
}

/// The Delaunay triangulation of observations.
struct Mesh {
    triangulation: Triangulation,
    /// Plane of each triangle; `None` if its corners are collinear.
    planes: Vec<Option<Plane>>,
    /// Longest edge of each triangle, in pixels.
    gaps: Vec<f64>,
    confidence: Vec<f64>,
}

impl Mesh {
    fn new(places: &[[f64; 2]], depths: &[f64], firmness: &[f64]) -> Option<Self> {
        let points: Vec<Point> = places.iter().map(|&[x, y]| Point { x, y }).collect();
        let triangulation = triangulate(&points);
        if triangulation.is_empty() {
            return None;
        }
        let inverse: Vec<f64> = depths.iter().map(|depth| depth.recip()).collect();
        let corners = triangulation.triangles.as_chunks::<3>().0;
        let planes = of_all(corners, |_, &corners| {
            Plane::through(corners, places, &inverse)
        });
        let gaps = of_all(&planes, |_, plane| {
            plane.as_ref().map_or(0.0, Plane::longest_edge)
        });
        let confidence = of_all(&planes, |i, plane| {
            let Some(plane) = plane else { return 0.0 };
            let hinge = |k: usize| {
                let other = triangulation.halfedges[3 * i + k];
                if other == EMPTY {
                    return f64::INFINITY;
                }
                let apex = triangulation.triangles[next_halfedge(next_halfedge(other))];
                plane.off(places[apex], inverse[apex])
            };
            let of = |values: &[f64]| corners[i].map(|corner| values[corner]);
            let [a, b, c] = of(depths);
            let spread = a.max(b).max(c) / a.min(b).min(c);
            let [a, b, c] = of(firmness);
            let square =
                (middle([0, 1, 2].map(hinge)) / HINGE).powi(2) + (spread.ln() / SPREAD).powi(2);
            a.min(b).min(c) / (1.0 + square)
        });
        Some(Self {
            triangulation,
            planes,
            gaps,
            confidence,
        })
    }

    /// The median over triangles of the longest edge, in pixels.
    fn usual_gap(&self) -> f64 {
        let pairs = self.planes.iter().zip(&self.gaps);
        let gaps = || pairs.clone().filter(|(plane, _)| plane.is_some());
        if gaps().next().is_none() {
            return f64::INFINITY;
        }
        median(gaps().map(|(_, gap)| *gap))
    }

    /// The observations around the one at which an edge ends, and the mean confidence of the triangles there; `None` at
    /// the outline.
    fn around(&self, edge: usize) -> Option<(Vec<usize>, f64)> {
        if edge == EMPTY {
            return None;
        }
        let (mut ring, mut confidence) = (Vec::new(), 0.0);
        let mut incoming = edge;
        loop {
            ring.push(self.triangulation.triangles[incoming]);
            confidence += self.confidence[incoming / 3];
            incoming = self.triangulation.halfedges[next_halfedge(incoming)];
            if incoming == EMPTY {
                return None;
            }
            if incoming == edge {
                break;
            }
        }
        let mean = confidence / ring.len() as f64;
        Some((ring, mean))
    }
}

/// Sets pixels without depth to approximately the nearest depth: distances are propagated between neighbours (Borgefors 1986).
/// Returns these distances, 0 at pixels with a depth.
fn continue_outside(depths: &mut [f64], (height, width): (usize, usize)) -> Vec<f32> {
    let distances = |depth: &f64| if *depth > 0.0 { 0.0 } else { f32::MAX };
    let mut distances: Vec<f32> = depths.iter().map(distances).collect();
    let mut relax = |at: usize, from: usize, step: f32| {
        if distances[from] + step < distances[at] {
            distances[at] = distances[from] + step;
            depths[at] = depths[from];
        }
    };
    let diagonal = std::f32::consts::SQRT_2;
    for forward in [true, false] {
        for i in 0..height * width {
            let at = if forward { i } else { height * width - 1 - i };
            let (x, y) = (at % width, at / width);
            // The neighbours that were already visited.
            let (beside, row) = if forward {
                (x.checked_sub(1), y.checked_sub(1))
            } else {
                (
                    Some(x + 1).filter(|x| *x < width),
                    Some(y + 1).filter(|y| *y < height),
                )
            };
            if let Some(x) = beside {
                relax(at, y * width + x, 1.0);
            }
            if let Some(y) = row {
                relax(at, y * width + x, 1.0);
                if x > 0 {
                    relax(at, y * width + x - 1, diagonal);
                }
                if x + 1 < width {
                    relax(at, y * width + x + 1, diagonal);
                }
            }
        }
    }
    distances
}

/// Returns the median of up to three distances; missing distances are infinite.
fn middle(mut values: [f64; 3]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values {
        [_, one, two] if two.is_finite() => one,
        [one, two, _] if two.is_finite() => 0.5 * (one + two),
        [one, ..] => one,
    }
}

/// A triangle in which inverse depth is linear.
struct Plane {
    corners: [[f64; 2]; 3],
    values: [f64; 3],
    area: f64,
}

impl Plane {
    /// `None` if the corners are collinear.
    fn through(corners: [usize; 3], places: &[[f64; 2]], values: &[f64]) -> Option<Self> {
        let [a, b, c] = corners.map(|i| places[i]);
        let area = cross(a, b, c);
        (area != 0.0).then(|| Self {
            corners: [a, b, c],
            values: corners.map(|i| values[i]),
            area,
        })
    }

    fn longest_edge(&self) -> f64 {
        let [a, b, c] = self.corners;
        let edges = [(a, b), (b, c), (c, a)];
        let squares = edges.map(|(p, q)| (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2));
        squares.into_iter().fold(0.0, f64::max).sqrt()
    }

    /// The barycentric coordinates of a position.
    fn shares(&self, place: [f64; 2]) -> [f64; 3] {
        let [a, b, c] = self.corners;
        let first = cross(b, c, place) / self.area;
        let second = cross(c, a, place) / self.area;
        [first, second, 1.0 - first - second]
    }

    fn contains(&self, place: [f64; 2]) -> bool {
        self.shares(place).into_iter().all(|share| share >= -1e-9)
    }

    fn at(&self, place: [f64; 2]) -> f64 {
        let pairs = self.shares(place).into_iter().zip(self.values);
        pairs.map(|(share, value)| share * value).sum()
    }

    /// Returns the distance of a value from the plane at a position, relative to the smallest of this value and those of the
    /// corners, in units of the error of the plane there if each corner had an error of 1.
    fn off(&self, place: [f64; 2], value: f64) -> f64 {
        let shares = self.shares(place);
        let expected: f64 = shares.iter().zip(self.values).map(|(s, v)| s * v).sum();
        let least = self.values.into_iter().fold(value, f64::min);
        let grown: f64 = shares.iter().map(|s| s * s).sum();
        (expected - value).abs() / (least * (1.0 + grown).sqrt())
    }

    /// Calls `then` with the pixels in the triangle and the inverse depth there. A pixel on an edge belongs to the triangle
    /// on the right or below of it alone.
    fn fill(&self, (height, width): (usize, usize), mut then: impl FnMut(usize, f64)) {
        let ys = self.corners.map(|c| c[1]);
        let (top, bottom) = (
            ys.into_iter().fold(f64::INFINITY, f64::min),
            ys.into_iter().fold(f64::NEG_INFINITY, f64::max),
        );
        let first = top.ceil().max(0.0);
        let mut y = first as usize;
        while y < height && (y as f64) < bottom {
            let line = y as f64;
            let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let (p, q) = (self.corners[k], self.corners[(k + 1) % 3]);
                // Identical for both triangles at an edge.
                let (p, q) = if p[1] <= q[1] { (p, q) } else { (q, p) };
                if p[1] <= line && line < q[1] {
                    let x = p[0] + (line - p[1]) / (q[1] - p[1]) * (q[0] - p[0]);
                    left = left.min(x);
                    right = right.max(x);
                }
            }
            if left <= right {
                let start = left.ceil().max(0.0) as usize;
                let end = (right.ceil().max(0.0) as usize).min(width);
                if start < end {
                    let value = self.at([start as f64, line]);
                    let slope = self.at([start as f64 + 1.0, line]) - value;
                    for x in start..end {
                        let inverse = value + slope * (x - start) as f64;
                        if inverse > 0.0 {
                            then(y * width + x, inverse);
                        }
                    }
                }
            }
            y += 1;
        }
    }
}

/// Twice the signed area of a triangle.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bilinear::InterpolationWeights;
    use crate::fit::{
        Affinities, BasisValues, EvaluateBasis, FieldGeometry, Fit, FitConfig, FitMethod,
        FitPoints, JointConfig, Lambda, PriorKind, fit,
    };
    use faer::linalg::solvers::Solve as _;
    use faer::{Mat, Side};
    use lsdc_rng::Rng;

    const SIZE: (usize, usize) = (24, 32);

    fn places(count: usize) -> Vec<[f64; 2]> {
        let mut rng = Rng::stream(0, &["surface"]);
        let mut one = |length: usize| f64::from(rng.unit()) * (length - 1) as f64;
        (0..count).map(|_| [one(SIZE.1), one(SIZE.0)]).collect()
    }

    /// A plane through the scene, as a pinhole camera sees it.
    fn slanted([x, y]: [f64; 2]) -> f64 {
        1.0 / (0.1 + 0.004 * x + 0.006 * y)
    }

    fn through(places: &[[f64; 2]], depth: impl Fn([f64; 2]) -> f64) -> Surface {
        let depths: Vec<f64> = places.iter().map(|&place| depth(place)).collect();
        Surface::through(places, &depths, &vec![1.0; places.len()], SIZE).unwrap()
    }

    #[test]
    fn planes_are_reproduced_and_trusted() {
        let found = through(&places(60), slanted);
        let mut inside = 0;
        for y in 0..SIZE.0 {
            for x in 0..SIZE.1 {
                let (depth, confidence) = (
                    found.depths[y * SIZE.1 + x],
                    found.confidence[y * SIZE.1 + x],
                );
                if !confidence.is_nan() {
                    let expected = slanted([x as f64, y as f64]);
                    assert!((depth / expected - 1.0).abs() < 1e-9, "{x} {y}: {depth}");
                    // The confidence in steep triangles is low.
                    assert!(confidence > 0.1, "{x} {y}: {confidence}");
                    inside += 1;
                }
            }
        }
        assert!(inside > 500, "{inside}");
    }

    #[test]
    fn what_lies_across_an_edge_is_not_trusted() {
        let near = |[x, _]: [f64; 2]| x < 15.5;
        let places = places(150);
        let found = through(&places, |place| if near(place) { 2.0 } else { 5.0 });
        let (mut on, mut across) = (0, 0);
        for (depth, confidence) in found.depths.iter().zip(&found.confidence) {
            if confidence.is_nan() {
                continue;
            }
            if (depth - 2.0).abs() < 1e-9 || (depth - 5.0).abs() < 1e-9 {
                on += usize::from(*confidence > 0.99);
            } else {
                assert!(*confidence < 0.1, "{depth}: {confidence}");
                across += 1;
            }
        }
        assert!(on > 300 && across > 30, "{on} {across}");
    }

    #[test]
    fn unsure_depths_and_too_few_of_them_span_little() {
        let places = places(40);
        let depths: Vec<f64> = places.iter().map(|&place| slanted(place)).collect();
        let confidence = |firmness: f64| {
            let found = Surface::through(&places, &depths, &[firmness; 40], SIZE).unwrap();
            found.confidence[12 * SIZE.1 + 16]
        };
        assert!((confidence(0.25) - 0.25 * confidence(1.0)).abs() < 1e-12);
        assert!(Surface::through(&places[..2], &depths[..2], &[1.0; 2], SIZE).is_none());
        let row: Vec<[f64; 2]> = (0..9).map(|x| [f64::from(x), 4.0]).collect();
        assert!(Surface::through(&row, &[2.0; 9], &[1.0; 9], SIZE).is_none());
    }

    #[test]
    fn an_observation_that_is_left_out_has_the_depth_of_the_surface_of_the_others() {
        let places = places(50);
        let depths: Vec<f64> = (0..50).map(|i| 3.0 + f64::from(i % 7)).collect();
        let sure = [1.0; 50];
        let found = left_out(&places, &depths, &sure);
        let mut inside = 0;
        for (observation, found) in found.into_iter().enumerate() {
            let Some(found) = found else { continue };
            let without =
                |values: &[f64]| [&values[..observation], &values[observation + 1..]].concat();
            let others = [&places[..observation], &places[observation + 1..]].concat();
            let mesh = Mesh::new(&others, &without(&depths), &sure[1..]).unwrap();
            let mut planes = mesh.planes.iter().flatten();
            let plane = planes
                .find(|plane| plane.contains(places[observation]))
                .unwrap();
            let expected = plane.at(places[observation]).recip();
            assert!((found.depth / expected - 1.0).abs() < 1e-9, "{observation}");
            assert!((0.0..=1.0).contains(&found.confidence));
            inside += 1;
        }
        assert!(inside > 30, "{inside}");
    }

    #[test]
    fn the_share_rises_from_the_outline_without_steps() {
        let found = through(&places(60), slanted);
        let shares: Vec<_> = found.up_to_outline(SIZE).collect();
        let share = |x: usize, y: usize| shares[y * SIZE.1 + x].map_or(0.0, |(_, share)| share);
        let step = 1.0 / found.usual_gap;
        assert!(step < 0.5, "{step}");
        for y in 0..SIZE.0 {
            for x in 1..SIZE.1 {
                assert!(
                    (share(x, y) - share(x - 1, y)).abs() < step + 1e-6,
                    "{x} {y}"
                );
                assert_eq!(
                    share(x, y) > 0.0,
                    !found.confidence[y * SIZE.1 + x].is_nan()
                );
            }
        }
        assert_eq!(share(SIZE.1 / 2, SIZE.0 / 2), 1.0);
    }

    #[test]
    fn gaps_are_wide_beside_the_usual_one() {
        // Squares of 4 pixels, with diagonals of 4 sqrt 2, in columns 0 to 96.
        let size = (80, 200);
        let places = (0..500).map(|i| [4.0 * f64::from(i % 25), 4.0 * f64::from(i / 25)]);
        let mut places: Vec<[f64; 2]> = places.collect();
        let usual = 4.0 * std::f64::consts::SQRT_2;
        let narrow = |places: &[[f64; 2]], x: usize| {
            let ones = vec![1.0; places.len()];
            Surface::through(places, &ones, &ones, size).unwrap().narrow[40 * size.1 + x]
        };
        let expected = |gap: f64| 1.0 / (1.0 + (gap / (4.0 * usual)).powi(2));
        assert!((narrow(&places, 50) - 16.0 / 17.0).abs() < 1e-9);
        // Column 95 is the last inside.
        for distance in [1, 10, 100] {
            let found = narrow(&places, 95 + distance);
            assert!(
                (found - expected(2.0 * distance as f64)).abs() < 1e-6,
                "{found}"
            );
        }
        // Between these and a column of others, triangles are long.
        places.extend((0..20).map(|i| [196.0, 4.0 * f64::from(i)]));
        let found = narrow(&places, 150);
        assert!(
            (expected(103.0)..expected(100.0)).contains(&found),
            "{found}"
        );
    }

    #[test]
    fn pixels_outside_continue_the_nearest_inside() {
        let mut depths = vec![0.0; 35];
        depths[2 * 7 + 1] = 1.0;
        depths[2 * 7 + 5] = 2.0;
        let distances = continue_outside(&mut depths, (5, 7));
        assert_eq!(distances[2 * 7..3 * 7], [1.0, 0.0, 1.0, 2.0, 1.0, 0.0, 1.0]);
        assert_eq!(distances[0], 1.0 + std::f32::consts::SQRT_2);
        for (i, depth) in depths.iter().enumerate() {
            // The middle is as near to both.
            assert!(match i % 7 {
                3 => [1.0, 2.0].contains(depth),
                x if x < 3 => *depth == 1.0,
                _ => *depth == 2.0,
            });
        }
    }

    /// A constant and two functions of the place.
    #[derive(Debug)]
    struct Known;

    fn row([x, y]: [f64; 2]) -> [f32; 3] {
        [1.0, (x / 16.0 - 1.0) as f32, (y / 5.0).sin() as f32]
    }

    impl EvaluateBasis for Known {
        fn count(&self) -> usize {
            3
        }

        fn at(&self, places: &[[f64; 2]]) -> Vec<f32> {
            places.iter().flat_map(|&place| row(place)).collect()
        }

        fn combine(&self, places: &[[f64; 2]], weights: &[f64]) -> Vec<f64> {
            let value = |&place: &[f64; 2]| {
                let pairs = row(place).into_iter().zip(weights);
                pairs.map(|(f, w)| f64::from(f) * w).sum()
            };
            places.iter().map(value).collect()
        }

        fn map(&self, grid: (usize, usize), weights: &[f64]) -> Vec<f32> {
            let found = self.combine(&centres(grid), weights);
            found.into_iter().map(|value| value as f32).collect()
        }
    }

    fn centres((height, width): (usize, usize)) -> Vec<[f64; 2]> {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [x as f64, y as f64]));
        pixels.collect()
    }

    /// Points of a slanted plane, a few with a box before it, in a grid of pixels with random affinities.
    struct Example {
        size: (usize, usize),
        affinities: Affinities,
        places: Vec<[f64; 2]>,
        depths: Vec<f32>,
        config: FitConfig,
    }

    impl Example {
        fn new(size: (usize, usize), count: usize, method: FitMethod) -> Self {
            let mut rng = Rng::stream(1, &["surface"]);
            let values: Vec<f32> = (0..2 * size.0 * size.1)
                .map(|_| rng.normal().exp())
                .collect();
            let mut places = centres(size);
            rng.choose(&mut places, count);
            places.truncate(count);
            // In the order of the pixels, which decides among triangulations that are as good.
            places.sort_by(|a, b| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0])));
            let depth = |&[x, y]: &[f64; 2]| {
                // In dense points, holes would be limited to the depths around.
                let on_box = count < 1000 && (8.0..18.0).contains(&x) && y > 10.0;
                let noise = f64::from(rng.normal()) * 0.01;
                ((if on_box { 2.5 } else { slanted([x, y]) }) * (1.0 + noise)) as f32
            };
            let depths = places.iter().map(depth).collect();
            Self {
                size,
                affinities: Affinities::new(size, &values).unwrap(),
                places,
                depths,
                config: FitConfig {
                    method,
                    prior: PriorKind::Flat,
                    lambda: Lambda::Fixed(0.05),
                    joint: JointConfig {
                        diagonal_regularisation: 1e-6,
                        ..JointConfig::default()
                    },
                    ..FitConfig::default()
                },
            }
        }

        fn fit(&self, keep: impl Fn(usize) -> bool) -> Fit {
            let kept: Vec<usize> = (0..self.places.len()).filter(|&i| keep(i)).collect();
            let depths: Vec<f32> = kept.iter().map(|&i| self.depths[i]).collect();
            let places: Vec<[f64; 2]> = kept.iter().map(|&i| self.places[i]).collect();
            let rows = Known.at(&places);
            let points = FitPoints {
                bases: BasisValues::Both(&rows, &Known),
                guides: 0,
                depths: &depths,
                deviations: None,
                places: Some(&places),
                geometry: Some(FieldGeometry {
                    affinities: &self.affinities,
                    size: self.size,
                    upsampling: None,
                    transient: false,
                }),
            };
            fit(&points, &self.config, None).unwrap()
        }

        fn map(&self, fit: &Fit) -> Vec<f64> {
            let mut map = Known.map(self.size, &fit.weights);
            fit.smooth().unwrap().add_to(self.size, &mut map);
            map.into_iter().map(f64::from).collect()
        }

        /// The minimum of the sum in the head of this file, for the weights of a fit.
        fn dense(&self, fit: &Fit, perspective: bool) -> Vec<f64> {
            let with = |functions: bool| self.minimum(fit, perspective, functions);
            let own = fit.field.as_ref().unwrap();
            let Some(stacked) = &own.stacked else {
                return with(self.config.method == FitMethod::Joint);
            };
            // The share of the way to the median of three maps.
            let depths: Vec<f64> = self.depths.iter().copied().map(f64::from).collect();
            let surface =
                Surface::through(&self.places, &depths, &vec![1.0; depths.len()], self.size)
                    .unwrap();
            let surface: Vec<_> = if depths.len() > 1000 {
                surface.up_to_outline(self.size).collect()
            } else {
                surface.inside().collect()
            };
            let others = with(false).into_iter().zip(surface);
            let maps = with(true).into_iter().zip(others);
            let mixed = maps.map(|(joint, (alone, surface))| {
                let Some((surface, share)) = surface else {
                    return joint;
                };
                let share = stacked.share * share;
                let mut three = [joint, alone, surface];
                three.sort_by(f64::total_cmp);
                (1.0 - share) * joint + share * three[1]
            });
            mixed.collect()
        }

        /// The minimum for the joint fit, or for the field alone.
        fn minimum(&self, fit: &Fit, perspective: bool, with_functions: bool) -> Vec<f64> {
            let depths: Vec<f64> = self.depths.iter().copied().map(f64::from).collect();
            let surface =
                Surface::through(&self.places, &depths, &vec![1.0; depths.len()], self.size)
                    .unwrap();
            let diagonal_regularisation = match self.config.method {
                FitMethod::Joint => self.config.joint.diagonal_regularisation,
                _ => 0.0,
            };
            let grid = self.affinities.grid(diagonal_regularisation);
            let functions = if with_functions {
                Known.combine(&centres(self.size), &fit.weights)
            } else {
                vec![0.0; self.size.0 * self.size.1]
            };
            let n = functions.len();
            let (mut matrix, mut right) = (Mat::<f64>::zeros(n, n), Mat::<f64>::zeros(n, 1));
            for i in 0..n {
                // The regularisation is that of the field, which is added to the functions.
                matrix[(i, i)] += diagonal_regularisation;
                right[(i, 0)] += diagonal_regularisation * functions[i];
                let along = ((i + 1) % self.size.1 > 0).then_some((i + 1, grid.right[i]));
                let down = (i + self.size.1 < n).then_some((i + self.size.1, grid.down[i]));
                for (j, affinity) in along.into_iter().chain(down) {
                    let (one, other) = (surface.confidence[i], surface.confidence[j]);
                    let outside = one.is_nan() || other.is_nan();
                    let confidence = if outside { 0.0 } else { one.min(other) };
                    let doubt = ((depths.len() as f64 / 50.0).log10()).clamp(0.0, 1.0)
                        * surface.narrow[i].min(surface.narrow[j]);
                    let basis_weight = 1.0 - doubt * if outside { 0.5 } else { 0.25 };
                    let step = confidence * (surface.depths[j] - surface.depths[i])
                        + (1.0 - confidence) * basis_weight * (functions[j] - functions[i]);
                    let mean = depths.iter().sum::<f64>() / depths.len() as f64;
                    let farther = surface.depths[i].max(surface.depths[j]);
                    let strength = if perspective {
                        (affinity + confidence.powi(8)) * mean / farther
                    } else {
                        affinity
                    };
                    for (a, b, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                        matrix[(a, b)] += sign * strength;
                    }
                    right[(j, 0)] += strength * step;
                    right[(i, 0)] -= strength * step;
                }
            }
            for (&[x, y], depth) in self.places.iter().zip(&depths) {
                let mean = depths.iter().sum::<f64>() / depths.len() as f64;
                let weight = 100.0 * if perspective { mean / depth } else { 1.0 };
                let pixel = y as usize * self.size.1 + x as usize;
                matrix[(pixel, pixel)] += weight;
                right[(pixel, 0)] += weight * depth;
            }
            let found = matrix.llt(Side::Lower).unwrap().solve(&right);
            found.col_as_slice(0).to_vec()
        }
    }

    #[test]
    fn maps_are_those_of_the_dense_equations() {
        let large = (40, 40);
        for (size, count, method, perspective) in [
            (SIZE, 60, FitMethod::Joint, false),
            (SIZE, 60, FitMethod::Field, true),
            (large, 1200, FitMethod::Joint, true),
        ] {
            let example = Example::new(size, count, method);
            let fit = example.fit(|_| true);
            if method == FitMethod::Joint {
                let stacked = fit.field.as_ref().unwrap().stacked.as_ref().unwrap();
                assert!(stacked.share > 0.5, "{}", stacked.share);
            }
            let pairs = example
                .map(&fit)
                .into_iter()
                .zip(example.dense(&fit, perspective));
            for (found, expected) in pairs {
                assert!(
                    (found - expected).abs() < 1e-4,
                    "{count}: {found} {expected}"
                );
            }
        }
    }

    #[test]
    fn what_basis_functions_know_is_left_to_them() {
        let mut example = Example::new(SIZE, 60, FitMethod::Joint);
        let share = |example: &Example| example.fit(|_| true).median_share().unwrap();
        assert!(share(&example) > 0.5);
        let known = |place: &[f64; 2]| Known.combine(&[*place], &[4.0, 0.8, 0.9])[0] as f32;
        example.depths = example.places.iter().map(known).collect();
        assert!(share(&example) < 0.05, "{}", share(&example));
        example.config.joint.surface = false;
        assert_eq!(example.fit(|_| true).median_share(), None);
    }

    #[test]
    fn scaled_depths_have_scaled_maps() {
        for (size, count) in [(SIZE, 60), ((40, 40), 1200)] {
            let example = Example::new(size, count, FitMethod::Joint);
            let scaled = |factor: f32| {
                let mut example = Example::new(size, count, FitMethod::Joint);
                example.depths.iter_mut().for_each(|depth| *depth *= factor);
                example.map(&example.fit(|_| true))
            };
            let unscaled = example.map(&example.fit(|_| true));
            // A power of two changes no bit.
            assert!(unscaled.iter().zip(scaled(4.0)).all(|(a, b)| 4.0 * a == b));
            for factor in [1e-3, 0.7, 1e6] {
                for (a, b) in unscaled.iter().zip(scaled(factor)) {
                    let expected = f64::from(factor) * a;
                    assert!(
                        (b - expected).abs() < 1e-5 * expected.abs(),
                        "{b} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn leave_one_out_errors_are_nearly_those_of_fits_without_the_point() {
        let example = Example::new(SIZE, 90, FitMethod::Joint);
        let all = example.fit(|_| true);
        let rows = Known.at(&example.places);
        let found = all.leave_one_out(&all.leverages(&rows));
        let error = |i: usize| {
            let without = example.map(&example.fit(|j| j != i));
            let interpolation = InterpolationWeights::new(example.places[i], SIZE, SIZE);
            f64::from(example.depths[i]) - interpolation.read(&without)
        };
        let expected: Vec<f64> = (0..90).map(error).collect();
        let size = |errors: &[f64]| errors.iter().map(|e| e * e).sum::<f64>().sqrt();
        let off: Vec<f64> = found.iter().zip(&expected).map(|(a, b)| a - b).collect();
        assert!((size(&found) / size(&expected) - 1.0).abs() < 0.2);
        assert!(
            size(&off) < 0.5 * size(&expected),
            "{} {}",
            size(&off),
            size(&expected)
        );
    }
}
