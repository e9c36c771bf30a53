//! `lsdc export`: a frame of a dataset as files.

use super::args::Export;
use super::{Exit, settings, ui};
use crate::data;
use crate::error::{Error, Result};
use crate::sample::Pattern;

pub(super) fn run(args: &Export) -> Result<Exit> {
    let mut config = args.settings.load()?;
    args.source.apply(&mut config.data);
    let frames = settings::open(&config.data, args.split)?;
    if args.index >= frames.len() {
        return Err(Error::config(format!(
            "there is no frame {}: the split has {}",
            args.index,
            frames.len()
        )));
    }
    let frame = frames.load(args.index)?;
    let sparse = Pattern::Exactly(args.points).draw(&frame.depth, args.seed, &frame.id);
    let path = |name: &str| args.output.join(name);
    let names = ["rgb.png", "depth.npy", "sparse.npy"];
    if let Some(name) = names.iter().find(|name| !args.force && path(name).exists()) {
        return Err(Error::config(format!("`{}` exists", path(name).display()))
            .hint("give --force to replace it, or another folder"));
    }
    std::fs::create_dir_all(&args.output).map_err(|e| Error::write(&args.output, e))?;
    data::write_rgb(&path("rgb.png"), &frame.rgb)?;
    data::write_npy(&path("depth.npy"), &frame.depth)?;
    data::write_npy(&path("sparse.npy"), &sparse)?;
    ui::print(&format!(
        "frame     {}, {} sparse points",
        frame.id,
        sparse.count()
    ));
    ui::print(&format!("written   {}", args.output.display()));
    Ok(Exit::Done)
}
