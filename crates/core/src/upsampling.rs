//! Interpolation of a map of the working grid at any position of a larger image, along the edges of that image.
//!
//! A position is interpolated from the four pixels of the grid around it. The bilinear weight of each is multiplied by the
//! similarity of its colour to the colour of the large image, and the weights are divided by their sum. Planes are interpolated
//! bilinearly where colours are uniform, and each side of an edge is interpolated from pixels on its own side.

use crate::bilinear::{InterpolationWeights, containing, neighbours};
use lsdc_kernels::schedule::InTasks;
use lsdc_kernels::simd::Level;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// The difference of two colours (0 to 255 in each channel) that halves a weight. Chosen from 5, 10 and 20 on training frames
/// and frames of other cameras; the results differ by less than 1 %.
const CONTRAST: f32 = 10.0;

/// Rows of the output per task.
const STRIP: usize = 16;

/// The colours of an image and of the smaller grid on which its depth is solved.
#[derive(Debug)]
pub struct Upsampling {
    /// Red, green and blue of every pixel of the image.
    image: Vec<u8>,
    /// Height and width of the image.
    size: (usize, usize),
    /// Red, green and blue of every pixel of the grid.
    colours: Vec<u8>,
    /// Height and width of the grid.
    grid: (usize, usize),
    level: Level,
}

/// The two pixels around a position on one axis, and the weight of the second.
type Between = (usize, usize, f32);

/// A rectangular block of pixels of the image.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct PixelBlock {
    columns: RangeInclusive<usize>,
    rows: RangeInclusive<usize>,
}

impl PixelBlock {
    /// Whether the block contains the pixel in this column and row.
    pub(crate) fn contains(&self, [x, y]: [usize; 2]) -> bool {
        self.columns.contains(&x) && self.rows.contains(&y)
    }
}

impl Upsampling {
    /// From colours `[height, width, 3]` of the image and of the grid, with the height and width of both. `None`
    /// unless the image is larger and the lengths match.
    pub fn new(
        (image, size): (Vec<u8>, (usize, usize)),
        (colours, grid): (Vec<u8>, (usize, usize)),
    ) -> Option<Self> {
        let larger = grid.0 > 0 && grid.1 > 0 && size.0 >= grid.0 && size.1 >= grid.1;
        let fitting = [(&image, size), (&colours, grid)]
            .iter()
            .all(|(values, (height, width))| values.len() == 3 * height * width);
        (larger && size != grid && fitting).then(|| Self {
            image,
            size,
            colours,
            grid,
            level: Level::here(),
        })
    }

    /// Height and width of the image.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The similarity of the colours of two pixels of the image, from 1 for equal colours towards 0.
    pub fn likeness(&self, one: usize, other: usize) -> f32 {
        likeness(square(colour(&self.image, one), colour(&self.image, other)))
    }

    /// Returns the pixels of the image whose centres are in the same pixel of the grid as the centre of this one.
    pub(crate) fn cell(&self, pixel: usize) -> PixelBlock {
        let same = |place: usize, size: usize, grid: usize| {
            let cell = |place: usize| containing(place as f64, size, grid);
            let own = cell(place);
            let first = (0..place).rev().take_while(|&p| cell(p) == own).last();
            let last = (place + 1..size).take_while(|&p| cell(p) == own).last();
            first.unwrap_or(place)..=last.unwrap_or(place)
        };
        PixelBlock {
            columns: same(pixel % self.size.1, self.size.1, self.grid.1),
            rows: same(pixel / self.size.1, self.size.0, self.grid.0),
        }
    }

    /// Height and width of the grid.
    pub fn grid(&self) -> (usize, usize) {
        self.grid
    }

    /// The pixels of the grid from which a position (u, v) is interpolated, in an image of `size` (height, width). This need
    /// not be the size of the image with the edges: the colour is that of its pixel at this position.
    pub fn interpolation(&self, [u, v]: [f64; 2], size: (usize, usize)) -> InterpolationWeights {
        let row = containing(v, size.0, self.size.0);
        let column = containing(u, size.1, self.size.1);
        let here = colour(&self.image, row * self.size.1 + column);
        let alike = |pixel: u32| {
            let there = colour(&self.colours, pixel as usize);
            f64::from(likeness(square(here, there)))
        };
        InterpolationWeights::new([u, v], size, self.grid).weighted(alike)
    }

    /// Interpolates a map of the grid at every pixel of an image of `size` (height, width), as [`Self::interpolation`] does.
    pub fn enlarge(&self, values: &[f32], size: (usize, usize)) -> Vec<f32> {
        assert_eq!(values.len(), self.grid.0 * self.grid.1, "values");
        let axis = |from: usize, to: usize| -> Vec<Between> {
            let between = |place: usize| neighbours(place as f64, from, to);
            let all = (0..from).map(between);
            all.map(|(low, high, share)| (low, high, share as f32))
                .collect()
        };
        let (rows, columns) = (axis(size.0, self.grid.0), axis(size.1, self.grid.1));
        let pixels: Vec<usize> = (0..size.1)
            .map(|x| containing(x as f64, size.1, self.size.1))
            .collect();
        let shares: Vec<f32> = columns.iter().map(|between| between.2).collect();
        let mut output = vec![0.0; size.0 * size.1];
        let strips = output.par_chunks_mut(STRIP * size.1.max(1));
        strips.enumerate().each(|(strip, output)| {
            let mut corners = Corners::new(size.1);
            let mut colours = [(); 3].map(|()| vec![0.0; size.1]);
            for (i, output) in output.chunks_exact_mut(size.1).enumerate() {
                let y = strip * STRIP + i;
                let (top, bottom, share) = rows[y];
                corners.fill(self, values, [top, bottom], &columns);
                let row = containing(y as f64, size.0, self.size.0);
                let image = &self.image[3 * row * self.size.1..][..3 * self.size.1];
                for (x, &pixel) in pixels.iter().enumerate() {
                    let colour = colour(image, pixel);
                    for (values, value) in colours.iter_mut().zip(colour) {
                        values[x] = value;
                    }
                }
                self.level
                    .vectorised(|| corners.read(&colours, &shares, share, output));
            }
        });
        output
    }
}

/// The four pixels around each position of an output row, channel by channel.
struct Corners {
    /// The two rows of the grid, if they are filled.
    rows: Option<[usize; 2]>,
    corners: [Corner; 4],
}

struct Corner {
    colours: [Vec<f32>; 3],
    values: Vec<f32>,
}

impl Corners {
    fn new(width: usize) -> Self {
        let corner = |()| Corner {
            colours: [(); 3].map(|()| vec![0.0; width]),
            values: vec![0.0; width],
        };
        Self {
            rows: None,
            corners: [(); 4].map(corner),
        }
    }

    /// Loads the corners of every position of an output row between two rows of the grid.
    fn fill(
        &mut self,
        upsampling: &Upsampling,
        values: &[f32],
        rows: [usize; 2],
        columns: &[Between],
    ) {
        if self.rows.replace(rows) == Some(rows) {
            return;
        }
        for (k, corner) in self.corners.iter_mut().enumerate() {
            let first = rows[k / 2] * upsampling.grid.1;
            for (x, &(left, right, _)) in columns.iter().enumerate() {
                let pixel = first + if k % 2 == 0 { left } else { right };
                let colour = colour(&upsampling.colours, pixel);
                for (values, value) in corner.colours.iter_mut().zip(colour) {
                    values[x] = value;
                }
                corner.values[x] = values[pixel];
            }
        }
    }

    #[inline(always)]
    fn read(&self, colours: &[Vec<f32>; 3], shares: &[f32], down: f32, output: &mut [f32]) {
        let width = output.len();
        let [red, green, blue] = [0, 1, 2].map(|channel| &colours[channel][..width]);
        let shares = &shares[..width];
        let corners = [0, 1, 2, 3].map(|k| {
            let Corner { colours, values } = &self.corners[k];
            let [red, green, blue] = [0, 1, 2].map(|channel| &colours[channel][..width]);
            (red, green, blue, &values[..width])
        });
        for x in 0..width {
            let (mut sum, mut total) = (0.0, 0.0);
            for (k, (reds, greens, blues, values)) in corners.iter().enumerate() {
                let there = [reds[x], greens[x], blues[x]];
                let alike = likeness(square([red[x], green[x], blue[x]], there));
                let across = if k % 2 == 0 {
                    1.0 - shares[x]
                } else {
                    shares[x]
                };
                let share = across * if k < 2 { 1.0 - down } else { down } * alike;
                sum += share * values[x];
                total += share;
            }
            output[x] = sum / total;
        }
    }
}

#[inline(always)]
fn colour(values: &[u8], pixel: usize) -> [f32; 3] {
    let colour = &values[3 * pixel..][..3];
    [colour[0], colour[1], colour[2]].map(f32::from)
}

/// Returns the squared difference of two colours.
#[inline(always)]
fn square(one: [f32; 3], other: [f32; 3]) -> f32 {
    let [red, green, blue] = [0, 1, 2].map(|channel| one[channel] - other[channel]);
    red * red + green * green + blue * blue
}

/// Returns the similarity for a squared difference of colours: 1 for equal colours, decreasing towards 0.
#[inline(always)]
fn likeness(square: f32) -> f32 {
    1.0 / (1.0 + square * (1.0 / (CONTRAST * CONTRAST)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_rng::Rng;
    use rayon::ThreadPoolBuilder;

    const GRID: (usize, usize) = (6, 8);
    const SIZE: (usize, usize) = (24, 32);

    /// Makes an image from colours by column and row; colours of the grid are the means of its 4x4 pixels.
    fn upsampling(shade: impl Fn(usize, usize) -> [u8; 3]) -> Upsampling {
        let pixels = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.1, i / SIZE.1));
        let image: Vec<u8> = pixels.flat_map(|(x, y)| shade(x, y)).collect();
        let cells = (0..GRID.0 * GRID.1).map(|i| (4 * (i % GRID.1), 4 * (i / GRID.1)));
        let mean = |(x, y): (usize, usize)| {
            [0, 1, 2].map(|channel| {
                let inside = (0..16).map(|i| u32::from(shade(x + i % 4, y + i / 4)[channel]));
                (inside.sum::<u32>() / 16) as u8
            })
        };
        let colours = cells.flat_map(mean).collect();
        Upsampling::new((image, SIZE), (colours, GRID)).unwrap()
    }

    fn noisy() -> Upsampling {
        let mut rng = Rng::stream(0, &["guide"]);
        let values: Vec<u8> = (0..3 * SIZE.0 * SIZE.1)
            .map(|_| (128.0 + 60.0 * rng.normal()) as u8)
            .collect();
        upsampling(|x, y| [0, 1, 2].map(|channel| values[3 * (y * SIZE.1 + x) + channel]))
    }

    fn map() -> Vec<f32> {
        let mut rng = Rng::stream(1, &["guide"]);
        (0..GRID.0 * GRID.1).map(|_| 3.0 + rng.normal()).collect()
    }

    #[test]
    fn a_step_between_two_colours_is_as_sharp_as_the_image() {
        // Next to the border of two pixels of the grid, and in the middle of one.
        for edge in [16, 18] {
            let upsampling = upsampling(|x, _| {
                if x < edge {
                    [30, 60, 90]
                } else {
                    [200, 180, 20]
                }
            });
            let step = |i: usize| if i % GRID.1 < 4 { 1.0 } else { 5.0 };
            let values: Vec<f32> = (0..GRID.0 * GRID.1).map(step).collect();
            let map = upsampling.enlarge(&values, SIZE);
            for (i, value) in map.iter().enumerate() {
                let x = i % SIZE.1;
                // The pixel of the grid across the edge has a mixed colour.
                if x.abs_diff(edge) < 2 * (edge - 16) {
                    continue;
                }
                let expected = if x < edge { 1.0 } else { 5.0 };
                assert!((value - expected).abs() < 0.05, "{edge} {x}: {value}");
            }
            // Bilinear interpolation has an error of half a metre next to the edge.
            let plain = InterpolationWeights::new([15.0, 11.0], SIZE, GRID);
            let values: Vec<f64> = values.iter().map(|&v| f64::from(v)).collect();
            assert!(plain.read(&values) > 2.4);
        }
    }

    #[test]
    fn even_colours_are_interpolated_bilinearly() {
        let upsampling = upsampling(|_, _| [90, 120, 30]);
        let plane = |x: f64, y: f64| 2.0 + 0.3 * x - 0.1 * y;
        let values: Vec<f32> = (0..GRID.0 * GRID.1)
            .map(|i| plane((i % GRID.1) as f64, (i / GRID.1) as f64) as f32)
            .collect();
        // At the size of the image, at another size, and at that of the grid.
        for size in [SIZE, (31, 50), GRID] {
            let found = upsampling.enlarge(&values, size);
            for (i, value) in found.iter().enumerate() {
                let at = |place: usize, from: usize, to: usize| {
                    let scaled = (place as f64 + 0.5) * to as f64 / from as f64 - 0.5;
                    scaled.clamp(0.0, (to - 1) as f64)
                };
                let (x, y) = (i % size.1, i / size.1);
                let expected = plane(at(x, size.1, GRID.1), at(y, size.0, GRID.0));
                assert!((f64::from(*value) - expected).abs() < 1e-5, "{x} {y}");
            }
        }
    }

    #[test]
    fn maps_and_positions_are_read_alike() {
        let (upsampling, map) = (noisy(), map());
        let values: Vec<f64> = map.iter().map(|&v| f64::from(v)).collect();
        for size in [SIZE, (31, 50), (11, 13)] {
            let found = upsampling.enlarge(&map, size);
            for (i, value) in found.iter().enumerate() {
                let place = [(i % size.1) as f64, (i / size.1) as f64];
                let interpolation = upsampling.interpolation(place, size);
                let total: f64 = interpolation.iter().map(|(_, share)| share).sum();
                assert!((total - 1.0).abs() < 1e-12);
                assert!((interpolation.read(&values) - f64::from(*value)).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn threads_and_units_change_nothing() {
        let (upsampling, map) = (noisy(), map());
        let within = |threads: usize| {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build();
            pool.unwrap().install(|| upsampling.enlarge(&map, (99, 70)))
        };
        let one = within(1);
        assert_eq!(one, within(3));
        let twice: Vec<f32> = map.iter().map(|v| 2.0 * v).collect();
        let pairs = upsampling.enlarge(&twice, (99, 70)).into_iter().zip(one);
        assert!(pairs.into_iter().all(|(two, one)| two == 2.0 * one));
    }

    #[test]
    fn images_that_are_not_larger_are_not_upsampled() {
        let colours =
            |(height, width): (usize, usize)| (vec![0; 3 * height * width], (height, width));
        assert!(Upsampling::new(colours(SIZE), colours(GRID)).is_some());
        assert!(Upsampling::new(colours(GRID), colours(GRID)).is_none());
        assert!(Upsampling::new(colours(GRID), colours(SIZE)).is_none());
        assert!(Upsampling::new((vec![0; 5], SIZE), colours(GRID)).is_none());
    }
}
