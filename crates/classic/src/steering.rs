//! Steering kernel regression (Takeda, Farsiu, Milanfar 2007): a local plane is fitted to the points around each pixel, with
//! Gaussian weights that are elongated along the image edges at each point. Here the edges are those of the colour image, and
//! the points are scattered.

use super::grey_values;
use super::neighbours::{Neighbours, each_pixel};
use crate::error::Result;
use faer::linalg::solvers::Solve as _;
use faer::{Mat, mat};
use image::RgbImage;
use lsdc_core::{DepthMap, Point};

/// Width of the kernel in units of the mean distance between points, chosen on training frames of
/// NYU Depth v2.
const WIDTH: f64 = 0.6;

/// Half the side of the window over which gradients are summed.
const WINDOW: usize = 3;

/// Regularisation of the kernel's elongation, for gradients of grey values of 0 to 255;
/// chosen on the same frames.
const ELONGATION: f64 = 10.0;

/// Number of nearest points used for a pixel.
const NEAREST: usize = 24;

/// The exponent of the dependence of the kernel's size on structure (Takeda et al.).
const SIZE: f64 = 0.25;

/// A point and the inverse covariance of its kernel.
struct SteeringKernel {
    point: Point,
    precision: [f64; 3],
}

pub(super) fn steering(rgb: &RgbImage, sparse: &DepthMap) -> Result<DepthMap> {
    let neighbours = Neighbours::new(sparse);
    let (width, height) = (sparse.width(), sparse.height());
    let spacing = ((width * height) as f64 / neighbours.points.len() as f64).sqrt();
    let gradients = Gradients::of(rgb);
    let kernels = neighbours.points.iter().map(|&point| SteeringKernel {
        point,
        precision: gradients.precision(point.x, point.y, WIDTH * spacing),
    });
    let kernels: Vec<SteeringKernel> = kernels.collect();
    let (low, high) = sparse.range().unwrap_or((0.0, 0.0));
    each_pixel(sparse, |x, y| {
        let nearest = neighbours.nearest(x, y, NEAREST);
        let mut moments = Moments::default();
        for &(_, i) in &nearest {
            let SteeringKernel { point, precision } = &kernels[i];
            let dx = point.x as f64 - x as f64;
            let dy = point.y as f64 - y as f64;
            let [a, b, c] = precision;
            let square = a * dx * dx + 2.0 * b * dx * dy + c * dy * dy;
            let weight = (a * c - b * b).sqrt() * (-0.5 * square).exp();
            moments.add(weight, dx / spacing, dy / spacing, point.depth.into());
        }
        let nearest = neighbours.points[nearest[0].1].depth;
        let value = moments.value();
        value.map_or(nearest, |v| (v as f32).clamp(low, high))
    })
}

/// The normal equations of a weighted plane.
#[derive(Default)]
struct Moments {
    weight: f64,
    first: [f64; 2],
    second: [f64; 3],
    depth: [f64; 3],
}

impl Moments {
    fn add(&mut self, weight: f64, dx: f64, dy: f64, depth: f64) {
        self.weight += weight;
        self.first[0] += weight * dx;
        self.first[1] += weight * dy;
        self.second[0] += weight * dx * dx;
        self.second[1] += weight * dx * dy;
        self.second[2] += weight * dy * dy;
        self.depth[0] += weight * depth;
        self.depth[1] += weight * depth * dx;
        self.depth[2] += weight * depth * dy;
    }

    /// Returns the plane's value at the pixel; a ridge penalty on its slopes limits extrapolation from few points on one side.
    fn value(&self) -> Option<f64> {
        let Self {
            weight: w,
            first: [x, y],
            second: [xx, xy, yy],
            depth,
        } = self;
        if *w < 1e-12 {
            return None;
        }
        let ridge = 0.1 * w;
        let matrix: Mat<f64> = mat![[*w, *x, *y], [*x, xx + ridge, *xy], [*y, *xy, yy + ridge]];
        let depth = Mat::from_fn(3, 1, |i, _| depth[i]);
        let value = matrix.partial_piv_lu().solve(&depth)[(0, 0)];
        value.is_finite().then_some(value)
    }
}

/// The gradients of an image's grey values.
struct Gradients {
    width: usize,
    height: usize,
    values: Vec<[f64; 2]>,
}

impl Gradients {
    fn of(rgb: &RgbImage) -> Self {
        let (width, height) = (rgb.width() as usize, rgb.height() as usize);
        let grey: Vec<f64> = grey_values(rgb).collect();
        let values = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let at = |x: usize, y: usize| grey[y.min(height - 1) * width + x.min(width - 1)];
                [
                    0.5 * (at(x + 1, y) - at(x.saturating_sub(1), y)),
                    0.5 * (at(x, y + 1) - at(x, y.saturating_sub(1))),
                ]
            })
            .collect();
        Self {
            width,
            height,
            values,
        }
    }

    /// Returns the inverse covariance (xx, xy, yy) of the kernel at a pixel: elongated perpendicular to the dominant gradient,
    /// smaller in structured areas.
    fn precision(&self, x: usize, y: usize, width: f64) -> [f64; 3] {
        let (mut xx, mut xy, mut yy, mut count) = (0.0, 0.0, 0.0, 0.0);
        for v in y.saturating_sub(WINDOW)..(y + WINDOW + 1).min(self.height) {
            for u in x.saturating_sub(WINDOW)..(x + WINDOW + 1).min(self.width) {
                let [gx, gy] = self.values[v * self.width + u];
                xx += gx * gx;
                xy += gx * gy;
                yy += gy * gy;
                count += 1.0;
            }
        }
        let half = 0.5 * (xx + yy);
        let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        let (s1, s2) = ((half + root).sqrt(), (half - root).max(0.0).sqrt());
        let stretch = (s1 + ELONGATION) / (s2 + ELONGATION);
        let size = ((s1 * s2 + 1.0) / count).powf(SIZE).max(1.0);
        // The direction of the dominant gradient.
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (sin, cos) = angle.sin_cos();
        let (across, along) = (stretch, 1.0 / stretch);
        let scale = size / (width * width);
        [
            scale * (across * cos * cos + along * sin * sin),
            scale * (across - along) * sin * cos,
            scale * (across * sin * sin + along * cos * cos),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn kernels_are_stretched_along_an_edge() {
        let rgb = RgbImage::from_fn(30, 30, |x, _| Rgb([if x < 15 { 10 } else { 240 }; 3]));
        let gradients = Gradients::of(&rgb);
        let [xx, xy, yy] = gradients.precision(15, 15, 5.0);
        assert!(xx > 4.0 * yy && xy.abs() < 1e-9, "{xx} {xy} {yy}");
        let [xx, _, yy] = gradients.precision(4, 15, 5.0);
        assert!((xx - 1.0 / 25.0).abs() < 1e-9 && (yy - 1.0 / 25.0).abs() < 1e-9);
    }
}
