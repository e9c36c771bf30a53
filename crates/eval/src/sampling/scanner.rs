//! Simulated returns of a spinning laser scanner beside the camera.

use super::Size;
use crate::data::{DepthMap, Frame, Point};
use image::{Pixel as _, Rgb};
use lsdc_rng::Rng;
use std::ops::RangeInclusive;

/// Range of beam counts of a scanner.
pub const BEAMS: RangeInclusive<usize> = 4..=128;

/// Horizontal field of view of the camera in degrees, assumed because frames have no intrinsics; the rectified images
/// of KITTI have 81. Pixels are square, and the optical axis meets the centre of the image.
const CAMERA: f64 = 80.0;
/// Azimuth step between returns of a beam, in degrees: Velodyne's VLP-16 at ten turns a second.
const AZIMUTH_STEP: f64 = 0.2;
/// Largest azimuth in degrees: beyond all pixels, for every pitch.
const SIDE: f64 = 45.0;
/// Largest pitch of the scanner relative to the camera, in degrees in either direction; drawn for each frame.
const PITCH: f32 = 5.0;
/// Standard deviation of a range as a fraction of the range, about 3 cm at 10 m. This and the constants below are chosen, not
/// measured.
const NOISE: f32 = 0.003;
/// Probability that a return from a white pixel is lost.
const LOST_ON_WHITE: f32 = 0.05;
/// Probability that a return from a black pixel is lost.
const LOST_ON_BLACK: f32 = 0.5;
/// Largest parallax between scanner and camera past an edge, as a fraction of the image width; drawn for each frame. The
/// scanner is above the camera.
const PARALLAX: f32 = 0.02;
/// Smallest ratio of the depths on both sides of an edge.
const FARTHER: f32 = 1.1;
/// Smallest break at an edge: inverse depth beyond it is below that of the extrapolated plane by this fraction of the edge's.
const BREAK: f32 = 0.05;
/// Share of the returns beside an edge that come from beyond it: near an edge, the scanner sees both surfaces.
const SEEN_PAST: f32 = 0.5;

/// Simulates the returns of a scanner with this many beams, at most one per pixel and none where the depth is unknown.
///
/// Beams have the elevations of a real scanner ([`banks`]). A few returns are lost, more on dark pixels. Ranges have noise, and
/// some returns have the depth of the background beside their pixel.
pub(super) fn returns(frame: &Frame, beams: usize, rng: &mut Rng) -> Vec<Point> {
    let depth = &frame.depth;
    let size = Size::of(depth);
    let (pitch, phase) = (rng.range(-PITCH, PITCH), rng.unit());
    let most = PARALLAX * size.width as f32;
    let parallax = [rng.range(-0.5 * most, 0.5 * most), rng.range(-most, 0.0)];
    let parallax = parallax.map(|pixels| pixels.round() as isize);
    let found = hits(beams, pitch.into(), phase.into(), size).into_iter();
    let found = found.filter_map(|(x, y)| {
        let here = depth.at(x, y);
        let colour = *frame.rgb.get_pixel(x as u32, y as u32);
        if rng.chance(lost(colour)) || here == 0.0 {
            return None;
        }
        let beyond = past_edge(depth, (x, y), parallax);
        let seen = beyond.filter(|_| rng.chance(SEEN_PAST)).unwrap_or(here);
        let depth = seen * (1.0 + NOISE * rng.normal());
        Some(Point { x, y, depth })
    });
    found.collect()
}

/// Returns the pixels (column, row) hit by beams, each once, from the highest beam down. Azimuths start after the fraction
/// `phase` of a step; the pitch is in degrees, upwards.
fn hits(beams: usize, pitch: f64, phase: f64, size: Size) -> Vec<(usize, usize)> {
    let Size { height, width } = size;
    let focal_length = width as f64 / 2.0 / (CAMERA / 2.0).to_radians().tan();
    let place = |slope: f64, length: usize| {
        let at = length as f64 / 2.0 + focal_length * slope;
        (0.0..length as f64).contains(&at).then_some(at as usize)
    };
    let steps = (2.0 * SIDE / AZIMUTH_STEP).round() as usize;
    let azimuths = (0..steps).map(|step| AZIMUTH_STEP * (step as f64 + phase) - SIDE);
    let azimuths: Vec<(f64, f64)> = azimuths.map(|a| a.to_radians().sin_cos()).collect();
    let (sin_pitch, cos_pitch) = pitch.to_radians().sin_cos();
    let mut is_hit = vec![false; width * height];
    let mut hits = Vec::new();
    for elevation in elevations(beams) {
        let (sin, cos) = elevation.to_radians().sin_cos();
        for (to_side, ahead) in &azimuths {
            let right = cos * to_side;
            let down = -sin * cos_pitch - cos * ahead * sin_pitch;
            let forward = cos * ahead * cos_pitch - sin * sin_pitch;
            let column = place(right / forward, width);
            if let Some((x, y)) = column.zip(place(down / forward, height))
                && !std::mem::replace(&mut is_hit[y * width + x], true)
            {
                hits.push((x, y));
            }
        }
    }
    hits
}

/// Returns the elevation of each beam in degrees, from the highest down, evenly spaced in each bank.
fn elevations(beams: usize) -> Vec<f64> {
    let banks = banks(beams);
    let before = |bank: usize| bank * beams / banks.len();
    let of_bank = |(bank, [from, to]): (usize, &[f64; 2])| {
        let count = before(bank + 1) - before(bank);
        let (from, step) = (*from, (to - from) / count.saturating_sub(1).max(1) as f64);
        (0..count).map(move |beam| from + step * beam as f64)
    };
    banks.iter().enumerate().flat_map(of_bank).collect()
}

/// Returns the highest and lowest nominal elevation of each bank of beams in degrees, for the smallest of five scanners with at
/// least this many beams. All banks have the same number of beams.
fn banks(beams: usize) -> &'static [[f64; 2]] {
    match beams {
        // Quanergy M8, by its client library; its steps are 2.8 to 3.2 degrees.
        ..=8 => &[[3.2, -18.25]],
        // Velodyne VLP-16.
        9..=16 => &[[15.0, -15.0]],
        // Velodyne HDL-32E.
        17..=32 => &[[10.67, -30.67]],
        // Velodyne HDL-64E.
        33..=64 => &[[2.0, -8.33], [-8.83, -24.33]],
        // Ouster OS1-128, nominally 45 degrees.
        _ => &[[22.5, -22.5]],
    }
}

/// Returns the probability that a return from this colour is lost.
fn lost(colour: Rgb<u8>) -> f32 {
    let [luma] = colour.to_luma().0;
    let darkness = 1.0 - f32::from(luma) / 255.0;
    LOST_ON_WHITE + (LOST_ON_BLACK - LOST_ON_WHITE) * darkness.powi(4)
}

/// Returns the depth at an offset from a pixel with known depth, if there is an edge between them.
fn past_edge(depth: &DepthMap, (x, y): (usize, usize), [right, down]: [isize; 2]) -> Option<f32> {
    let known = |right: isize, down: isize| {
        let x = x.checked_add_signed(right).filter(|x| *x < depth.width())?;
        let y = y.checked_add_signed(down).filter(|y| *y < depth.height())?;
        Some(depth.at(x, y)).filter(|depth| *depth > 0.0)
    };
    let (here, beyond) = (depth.at(x, y), known(right, down)?);
    let opposite = known(-right, -down)?;
    // Inverse depth is linear on planes, so that slanted ground has no edges.
    let of_plane = 2.0 / here - 1.0 / opposite;
    let is_edge = beyond > FARTHER * here && 1.0 / beyond < of_plane - BREAK / here;
    is_edge.then_some(beyond)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::RgbImage;

    const SIZE: Size = Size {
        height: 120,
        width: 160,
    };

    /// A wall 10 m away and parallel to the image.
    fn wall(level: u8) -> Frame {
        let rgb = RgbImage::from_pixel(160, 120, Rgb([level; 3]));
        let depth = DepthMap::new(160, 120, vec![10.0; 160 * 120]).unwrap();
        Frame::new("wall".into(), rgb, depth).unwrap()
    }

    /// A white image of 320x240 pixels.
    fn white(depth: impl Fn(usize, usize) -> f32) -> Frame {
        let depths = (0..320 * 240).map(|i| depth(i % 320, i / 320));
        let depth = DepthMap::new(320, 240, depths.collect()).unwrap();
        let rgb = RgbImage::from_pixel(320, 240, Rgb([255; 3]));
        Frame::new("white".into(), rgb, depth).unwrap()
    }

    #[test]
    fn beams_have_the_elevations_of_their_scanners() {
        let sixteen: Vec<f64> = (0..16).map(|beam| 15.0 - 2.0 * beam as f64).collect();
        assert_eq!(elevations(16), sixteen);
        // Steps of 1/3 degree in the upper block of the HDL-64E, 1/2 degree in the lower one.
        let found = elevations(64);
        let expected = [(0, 2.0), (1, 1.667), (31, -8.33), (32, -8.83), (33, -9.33)];
        for (beam, elevation) in expected.into_iter().chain([(63, -24.33)]) {
            assert!((found[beam] - elevation).abs() < 1e-3, "{beam}");
        }
        // 21.45 degrees in seven steps.
        for (beam, elevation) in elevations(8).into_iter().enumerate() {
            let expected = 3.2 - 3.064_286 * beam as f64;
            assert!((elevation - expected).abs() < 1e-5, "{beam}");
        }
        for beams in BEAMS {
            let found = elevations(beams);
            assert_eq!(found.len(), beams);
            assert!(found.is_sorted_by(|above, below| above > below), "{beams}");
        }
    }

    #[test]
    fn rows_are_where_the_pinhole_camera_has_them() {
        // 60 - 80 / tan(40 degrees) x tan(elevation + pitch) in the middle column.
        let level = [
            34, 37, 41, 44, 48, 51, 55, 58, 61, 64, 68, 71, 75, 78, 82, 85,
        ];
        let up = [
            27, 30, 34, 37, 41, 44, 48, 51, 55, 58, 61, 64, 68, 71, 75, 78,
        ];
        for (pitch, rows) in [(0.0, level), (4.0, up)] {
            let found = hits(16, pitch, 0.5, SIZE);
            let middle = found.iter().filter(|(x, _)| *x == 80);
            assert_eq!(middle.map(|(_, y)| *y).collect::<Vec<_>>(), rows);
        }
        // The other factor is 1 / cos(azimuth): at 39.8 degrees, 33.2 instead of 25.5 rows from the middle.
        let found = hits(16, 0.0, 0.5, SIZE);
        let last: Vec<usize> = found.iter().filter(|p| p.0 == 159).map(|p| p.1).collect();
        assert_eq!((last[0], last[last.len() - 1]), (26, 93));
    }

    #[test]
    fn dark_pixels_lose_more_returns_and_ranges_have_noise() {
        for (level, lost) in [(255, 0.05), (0, 0.5)] {
            let frame = wall(level);
            let (mut hit, mut errors) = (0, Vec::new());
            for seed in 0..10 {
                let mut rng = Rng::stream(seed, &[]);
                let mut same = rng.clone();
                let (pitch, phase) = (same.range(-PITCH, PITCH), same.unit());
                hit += hits(128, pitch.into(), phase.into(), SIZE).len();
                let found = returns(&frame, 128, &mut rng);
                errors.extend(found.iter().map(|p| f64::from(p.depth) / 10.0 - 1.0));
            }
            let (hit, kept) = (hit as f64, errors.len() as f64);
            let deviation = (hit * lost * (1.0 - lost)).sqrt();
            let excess = (kept - hit * (1.0 - lost)) / deviation;
            assert!(excess.abs() < 4.0, "{level}: {excess}");
            let variance = errors.iter().map(|e| e * e).sum::<f64>() / kept;
            assert!((variance.sqrt() / 0.003 - 1.0).abs() < 0.03, "{variance}");
        }
    }

    #[test]
    fn background_is_seen_past_the_upper_edge_of_what_is_near() {
        let is_near = |x: usize, y: usize| (100..220).contains(&x) && (60..180).contains(&y);
        let frame = white(|x, y| if is_near(x, y) { 2.0 } else { 10.0 });
        let (mut past, mut all) = (0, 0);
        for seed in 0..20 {
            let found = returns(&frame, 128, &mut Rng::stream(seed, &[]));
            all += found.len();
            for point in found {
                if !is_near(point.x, point.y) {
                    assert!((point.depth - 10.0).abs() < 0.3, "{point:?}");
                } else if point.depth > 5.0 {
                    past += 1;
                    // At most 3.2 pixels sideways and 6.4 up.
                    let beside = !(104..216).contains(&point.x) || point.y < 67;
                    assert!(beside, "{point:?}");
                }
            }
        }
        // Half of 3.2 x 120 + 1.6 x 120 pixels on average, out of about 50,000.
        let share = f64::from(past) / all as f64;
        assert!((0.002..0.02).contains(&share), "{share}");
    }

    #[test]
    fn edges_are_breaks_in_inverse_depth() {
        let past = |depths: [f32; 3], right: isize| {
            let depth = DepthMap::new(3, 1, depths.to_vec()).unwrap();
            past_edge(&depth, (1, 0), [right, 0])
        };
        // 1 / 2.3 = 0.435 is below 0.5 - 0.025.
        assert_eq!(past([2.0, 2.0, 2.3], 1), Some(2.3));
        assert_eq!(past([2.3, 2.0, 2.0], -1), Some(2.3));
        assert_eq!(past([2.0, 2.0, 2.3], -1), None);
        // A plane: inverse depths of 0.75, 0.5 and 0.25.
        assert_eq!(past([4.0 / 3.0, 2.0, 4.0], 1), None);
        // A wall beyond a slope: 0.75, 0.5 and 0.1.
        assert_eq!(past([4.0 / 3.0, 2.0, 10.0], 1), Some(10.0));
        assert_eq!(past([0.0, 2.0, 10.0], 1), None);
        assert_eq!(past([2.0, 2.0, 0.0], 1), None);
        assert_eq!(past([2.0, 2.0, 10.0], 2), None);
    }

    #[test]
    fn ground_is_seen_where_it_is() {
        // Six rows up, the ground is up to thirteen times as far; 1.1 times in row 185.
        let ground = |_: usize, y: usize| -> f32 {
            if y < 120 {
                0.0
            } else {
                286.0 / (y as f32 - 119.5)
            }
        };
        let frame = white(ground);
        for seed in 0..20 {
            let found = returns(&frame, 128, &mut Rng::stream(seed, &[]));
            assert!(found.len() > 5000, "{}", found.len());
            for point in found {
                let error = point.depth / ground(point.x, point.y) - 1.0;
                assert!(error.abs() < 0.02, "{point:?}");
            }
        }
    }
}
