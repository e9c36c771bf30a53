//! Pictures of basis functions, and of the similarity between pixels.

use super::{ColourScale, Drawing, Panel, Panels, diverging};
use crate::predict::scene;
use image::{Rgb, RgbImage};
use lsdc_core::Completer;
use lsdc_files::error::Result;

/// Pixels whose kernels are shown, as fractions of width and height.
const KERNEL_PIXELS: [(f64, f64); 4] = [(0.2, 0.3), (0.75, 0.25), (0.3, 0.75), (0.7, 0.7)];
/// Limit of basis functions on the contact sheet.
const MAX_FUNCTIONS: usize = 30;
const COLUMNS: usize = 5;

/// Returns a diverging colour scale for signed numbers, from blue to red.
pub fn diverging_scale(name: &str, limit: f32) -> ColourScale {
    ColourScale {
        name: name.into(),
        low: limit,
        high: -limit,
        unit: "",
        map: colorous::RED_BLUE,
    }
}

/// Returns the learned basis functions of an image without their means, `[pixels, N]`, and N.
fn centred_functions(completer: &Completer, rgb: &RgbImage) -> Result<(Vec<f32>, usize)> {
    let (width, height) = rgb.dimensions();
    let pixels = 0..width * height;
    let position = |pixel: u32| [f64::from(pixel % width), f64::from(pixel / width)];
    let positions: Vec<_> = pixels.clone().map(position).collect();
    let rows = scene(completer, rgb)?.basis_functions(&positions);
    // The first function is constant.
    let stride = rows.len() / pixels.len();
    let learned = rows.chunks_exact(stride).flat_map(|row| &row[1..]);
    let values: Vec<f32> = learned.copied().collect();
    Ok((centred(&values, stride - 1), stride - 1))
}

/// Returns an image, and for some of its pixels the correlation with the basis functions of all pixels, from -1 to 1.
///
/// # Errors
/// An image without pixels.
pub fn kernels(completer: &Completer, rgb: RgbImage) -> Result<Vec<Panel>> {
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let (centred, count) = centred_functions(completer, &rgb)?;
    let norms: Vec<f32> = centred
        .chunks_exact(count)
        .map(|row| dot(row, row).sqrt())
        .collect();
    let mut marked = rgb;
    let mut panels = Vec::new();
    for (number, (across, down)) in (1..).zip(KERNEL_PIXELS) {
        let (x, y) = (
            (across * width as f64) as usize,
            (down * height as f64) as usize,
        );
        let here = y * width + x;
        let own = &centred[here * count..][..count];
        let similarity = centred.chunks_exact(count).zip(&norms);
        let similarity: Vec<f32> = similarity
            .map(|(row, norm)| dot(row, own) / (norm * norms[here]).max(f32::EPSILON))
            .collect();
        let mut image = diverging(&similarity, width, 1.0);
        cross(&mut image, x, y, Rgb([0, 0, 0]));
        cross(&mut marked, x, y, Rgb([255, 230, 0]));
        panels.push(Panel {
            caption: format!("pixel {number}"),
            image,
        });
    }
    panels.insert(
        0,
        Panel {
            caption: "image".into(),
            image: marked,
        },
    );
    Ok(panels)
}

/// Draws the basis functions with the largest standard deviations over an image.
///
/// # Errors
/// An image without pixels.
pub fn contact_sheet(completer: &Completer, rgb: &RgbImage) -> Result<Drawing> {
    let width = rgb.width() as usize;
    let (centred, count) = centred_functions(completer, rgb)?;
    let mut square_sums = vec![0.0_f32; count];
    for row in centred.chunks_exact(count) {
        square_sums
            .iter_mut()
            .zip(row)
            .for_each(|(power, v)| *power += v * v);
    }
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| square_sums[b].total_cmp(&square_sums[a]));
    let pixels = centred.len() / count.max(1);
    let panel = |&function: &usize| {
        let map: Vec<f32> = centred
            .iter()
            .skip(function)
            .step_by(count)
            .copied()
            .collect();
        let deviation = (square_sums[function] / pixels.max(1) as f32).sqrt();
        Panel {
            caption: format!("f{} ({deviation:.2})", function + 1),
            image: diverging(&map, width, 2.5 * deviation),
        }
    };
    let panels: Vec<Panel> = order.iter().take(MAX_FUNCTIONS).map(panel).collect();
    let mut rows = vec![vec![Panel {
        caption: "image".into(),
        image: rgb.clone(),
    }]];
    rows.extend(panels.chunks(COLUMNS).map(<[Panel]>::to_vec));
    let panels = Panels {
        title: "Basis functions less their means, and their standard deviations".into(),
        scales: vec![diverging_scale("standard deviations", 2.5)],
        rows,
    };
    Ok(panels.draw())
}

/// Subtracts the mean of each function from values `[pixels, count]`.
fn centred(values: &[f32], count: usize) -> Vec<f32> {
    let mut means = vec![0.0_f64; count];
    for row in values.chunks_exact(count) {
        means
            .iter_mut()
            .zip(row)
            .for_each(|(m, v)| *m += f64::from(*v));
    }
    let pixels = (values.len() / count.max(1)).max(1) as f64;
    let less = |(i, v): (usize, &f32)| (f64::from(*v) - means[i % count] / pixels) as f32;
    values.iter().enumerate().map(less).collect()
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cross(image: &mut RgbImage, x: usize, y: usize, colour: Rgb<u8>) {
    const ARM: i64 = 5;
    for step in -ARM..=ARM {
        for (dx, dy) in [(step, 0), (0, step), (step, 1), (1, step)] {
            let (x, y) = (x as i64 + dx, y as i64 + dy);
            if x >= 0 && y >= 0 && x < i64::from(image.width()) && y < i64::from(image.height()) {
                image.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
}
