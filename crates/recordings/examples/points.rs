//! Prints the points of every image of a recording as its camera sees them: lines of stamp, u, v and depth.
//!
//!     cargo run --release -p lsdc-recordings --example points -- drive.mcap [--no-deskew]

use lsdc_recordings::{FrameOptions, Frames, Recording};
use std::io::{Write as _, stdout};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let path = args.next().ok_or("name a recording")?;
    let wanted = FrameOptions {
        deskew: args.next().as_deref() != Some("--no-deskew"),
        ..FrameOptions::default()
    };
    let mut recording = Recording::open(path.as_ref())?;
    let frames = Frames::of(&mut recording, &wanted)?;
    let mut out = std::io::BufWriter::new(stdout().lock());
    for frame in &frames.found {
        // An image without points is skipped.
        let Ok(loaded) = frames.read(&mut recording, frame)?.decode(&frames) else {
            continue;
        };
        for point in &loaded.points.points {
            writeln!(
                out,
                "{},{},{},{}",
                frame.stamp, point.u, point.v, point.depth
            )?;
        }
    }
    Ok(out.flush()?)
}
