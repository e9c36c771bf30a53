//! Weights of your own, as `lsdc train` writes them, and settings of the fit.
//!
//!     cargo run --release -p lsdc-core --example own_weights [weights.safetensors]

#![allow(clippy::print_stdout, clippy::unwrap_used)]

#[path = "room/mod.rs"]
mod files;

use lsdc_core::settings::{FitConfig, FitMethod};
use lsdc_core::{Channels, Completer, Image, Weights};
use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let own = std::env::args().nth(1).map(PathBuf::from);
    let ours = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("weights/small.safetensors");
    let weights = Weights::read(own.unwrap_or(ours))?;
    let recorded = weights.fit()?.unwrap_or_default();
    println!("{} parameters, {recorded}", weights.parameters());

    let rgb = files::image()?;
    let (width, height) = (rgb.width() as usize, rgb.height() as usize);
    let image = Image::new(width, height, Channels::Rgb, rgb.as_raw())?;
    let points = files::points(width)?;
    let mut residuals = Vec::new();
    for method in [FitMethod::Lse, FitMethod::Joint] {
        let fit = FitConfig { method, ..recorded };
        let completer = Completer::builder(&weights).fit(fit).build()?;
        let completion = completer.scene(&image)?.complete(&points)?;
        println!(
            "{}: {:.4} m at the points",
            method.name(),
            completion.report().residual
        );
        residuals.push(completion.report().residual);
    }
    // A field follows points that basis functions alone cannot represent.
    assert!(residuals[1] < residuals[0]);
    Ok(())
}
