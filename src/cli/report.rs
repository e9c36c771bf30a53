//! `lsdc report`: reports joined and shown.

use super::args::{Curves, Merge, Runs};
use super::eval::Outputs;
use super::{Exit, ui};
use lsdc_eval::data::check_output;
use lsdc_eval::report::{Curve, EvaluationReport, Training};
use lsdc_files::error::{Error, Result};

pub(super) fn merge(args: &Merge) -> Result<Exit> {
    let mut whole: Option<EvaluationReport> = None;
    for path in &args.files {
        let part = EvaluationReport::read_json(path)?;
        match &mut whole {
            None => whole = Some(part),
            Some(whole) => whole.join(part)?,
        }
    }
    let whole = whole.ok_or_else(|| Error::config("there is no report to join"))?;
    let whole = whole.complete()?;
    if let Some(folder) = &args.output {
        let existing = folder.join("report.json");
        check_output(&existing, args.force)?;
        std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, e))?;
        Outputs::folder(folder).write(&whole, &[])?;
    }
    ui::print(&whole.to_string());
    Ok(Exit::Done)
}

pub(super) fn curve(args: &Curves) -> Result<Exit> {
    let reports = args
        .files
        .iter()
        .map(|path| EvaluationReport::read_json(path));
    let curve = Curve::of(&reports.collect::<Result<Vec<_>>>()?)?;
    if let Some(path) = &args.html {
        check_output(path, args.force)?;
        curve.write_html(path)?;
    }
    ui::print(&curve.to_string());
    Ok(Exit::Done)
}

pub(super) fn training(args: &Runs) -> Result<Exit> {
    let training = Training::read(&args.folders)?;
    if let Some(path) = &args.html {
        check_output(path, args.force)?;
        training.write_html(path)?;
    }
    ui::print(&training.to_string());
    Ok(Exit::Done)
}
