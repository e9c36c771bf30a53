//! `lsdc complete`: images and their points to dense depth.

mod frame;
mod many;
mod outputs;

use super::args::Complete;
use super::{Exit, ui};
use crate::data::{self, Sparse};
use crate::error::Result;
use frame::Engine;
use outputs::Outputs;
use std::path::Path;
use std::time::Instant;

pub(super) fn run(args: &Complete) -> Result<Exit> {
    if args.rgb.is_dir() {
        many::run(args)
    } else {
        one(args)
    }
}

fn one(args: &Complete) -> Result<Exit> {
    let started = Instant::now();
    let rgb = data::read_rgb(&args.rgb)?;
    let size = (rgb.width() as usize, rgb.height() as usize);
    let mut points = Sparse::read(&args.sparse, args.depth_unit, size)?;
    if let Some(path) = &args.sigma {
        points.sigma = Some(Sparse::read(path, Some(points.unit), size)?.depth);
    }
    let read = started.elapsed();
    let found = Engine::new(args)?.complete(&rgb, &points)?;
    let writing = Instant::now();
    let folder = args.output.as_deref().or(args.rgb.parent());
    let stem = args.rgb.file_stem().unwrap_or_default().to_string_lossy();
    let folder = folder.filter(|folder| !folder.as_os_str().is_empty());
    let outputs = Outputs::new(args, folder.unwrap_or(Path::new(".")), &stem);
    outputs.write(&found, &points.depth)?;
    print_points(&points);
    if let Some((low, high)) = found.depth.range() {
        ui::print(&format!(
            "depth     {low:.3} to {high:.3} m, {}x{}",
            found.depth.width(),
            found.depth.height()
        ));
    }
    if let Some(fitted) = &found.fitted {
        fitted.print();
    }
    ui::print(&format!(
        "total     {} (reading {}, writing {})",
        ui::millis(started.elapsed()),
        ui::millis(read),
        ui::millis(writing.elapsed())
    ));
    ui::print(&format!("written   {}", outputs.first().display()));
    Ok(Exit::Done)
}

/// What was read, and how.
fn print_points(points: &Sparse) {
    let left_out = [
        (points.ignored, "NaN, infinite or negative values ignored"),
        (points.outside, "outside the image"),
        (points.hidden, "behind others in their pixel"),
    ];
    let left_out = left_out.into_iter().filter(|(count, _)| *count > 0);
    let left_out: Vec<String> = left_out
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    let note = if left_out.is_empty() {
        String::new()
    } else {
        format!(" ({})", left_out.join(", "))
    };
    ui::print(&format!("points    {}{note}", points.depth.count()));
    let guess = if points.guessed {
        " (a guess; --depth-unit says otherwise)"
    } else {
        ""
    };
    ui::print(&format!("unit      {}{guess}", points.unit));
}
