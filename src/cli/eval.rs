//! `lsdc eval`: methods side by side on a dataset.

use super::args::Eval;
use super::{Exit, settings, ui};
use crate::device::device;
use crate::error::Result;
use crate::eval::evaluate;
use crate::predict::Completer;
use std::ops::ControlFlow;
use std::sync::atomic::Ordering;

pub(super) fn run(args: &Eval) -> Result<Exit> {
    let mut config = args.settings.load()?;
    args.source.apply(&mut config.data);
    let eval = &mut config.eval;
    eval.points = args.points.unwrap_or(eval.points);
    eval.seed = args.seed.unwrap_or(eval.seed);
    eval.limit = args.limit.or(eval.limit);
    if !args.method.is_empty() {
        eval.methods.clone_from(&args.method);
    }
    eval.check()?;
    let mut protocol = eval
        .protocol
        .unwrap_or(settings::protocol_of(config.data.dataset));
    if let Some(depth_resize) = args.depth_resize {
        protocol.depth_resize = depth_resize;
    }
    let frames = settings::open(&config.data, args.split)?;
    let completer = Completer::open(args.model.weights.as_deref(), &device(&args.model.device)?)?;
    let completer = match config.fit {
        Some(fit) => completer.with_fit(fit),
        None => completer,
    };

    let name = format!("{} {}", config.data.dataset.name(), args.split.name());
    let stop = ui::stop_flag();
    let bar = ui::bar(frames.len(), "frames");
    let report = evaluate(
        &*frames,
        &name,
        &protocol,
        eval,
        &completer,
        |done, total| {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
            if stop.load(Ordering::Relaxed) {
                ControlFlow::Break(())
            } else {
                ControlFlow::Continue(())
            }
        },
    )?;
    bar.finish_and_clear();

    ui::print(&report.to_string());
    if let Some(path) = &args.json {
        report.write_json(path)?;
    }
    if let Some(path) = &args.csv {
        report.write_csv(path)?;
    }
    for (frame, error) in report.failures() {
        ui::say(&format!("frame `{frame}` failed: {error}"));
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(Exit::Interrupted);
    }
    Ok(if report.failures().is_empty() {
        Exit::Done
    } else {
        Exit::Partial
    })
}
