//! Computes dense depth from an image and sparse depths, and evaluates the error estimates of the fit.
//!
//!     cargo run --release -p lsdc-core --example room

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::{Channels, Completer, Image, Weights};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);

    let completer = Completer::new(&Weights::builtin())?;
    let scene = completer.scene(&Image::new(width, height, Channels::Rgb, rgb.as_raw())?)?;
    let completion = scene.complete(&files::points(width)?)?;
    let depth = completion.depth()?;
    let deviation = completion.standard_deviation()?;

    // The room is rendered, so its true depth is known.
    let truth = files::map("depth.npy", width)?;
    let (mut squares, mut within) = (0.0, 0);
    for &(u, v, expected) in &truth {
        let (x, y) = (u as usize, v as usize);
        let error = depth.at(x, y) - expected;
        squares += f64::from(error).powi(2);
        within += usize::from(error.abs() < deviation.at(x, y));
    }
    let rmse = (squares / truth.len() as f64).sqrt();
    let share = within as f64 / truth.len() as f64;
    println!("{} points, RMSE {rmse:.3} m", completion.report().used);
    println!(
        "{:.0} % of the errors are within a standard deviation",
        100.0 * share
    );
    let expected = completion.leave_one_out_error().unwrap();
    println!("leave-one-out error: {expected:.3} m");
    assert!((rmse / expected - 1.0).abs() < 0.2, "{rmse} {expected}");
    Ok(())
}
