//! Training curves of one or several runs.

use super::chart::{AxisScales, Chart, Line};
use super::html::write_charts;
use lsdc_files::error::{Cause, Error, Result};
use serde::Deserialize;
use std::fmt::{Display, Formatter};
use std::path::Path;

/// The curves of training runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Training(Vec<Run>);

/// A run, read from its `metrics.jsonl`.
#[derive(Clone, Debug, PartialEq)]
struct Run {
    name: String,
    steps: usize,
    /// Mean time of a step, in seconds.
    seconds: f64,
    /// Step and loss, averaged over spans of steps to reduce the noise of batches.
    loss: Vec<(f64, f64)>,
    /// Step and root mean squared error of the batches, in metres.
    rmse: Vec<(f64, f64)>,
    /// Step, RMSE in metres and REL on held-out frames.
    held_out: Vec<(f64, f64, f64)>,
}

#[derive(Deserialize)]
struct Entry {
    step: usize,
    loss: Option<f64>,
    rmse: Option<f64>,
    seconds: Option<f64>,
    held_out: Option<HeldOut>,
}

#[derive(Deserialize)]
struct HeldOut {
    rmse: f64,
    rel: f64,
}

/// Points of a curve: step and value.
type Points = Vec<(f64, f64)>;

/// Limit of points of a curve.
const MAX_POINTS: usize = 60;

impl Training {
    /// Reads `metrics.jsonl` of run folders.
    ///
    /// # Errors
    /// A folder has no such file, a line is malformed, or there is no step.
    pub fn read(folders: &[impl AsRef<Path>]) -> Result<Self> {
        let runs = folders.iter().map(|folder| Run::read(folder.as_ref()));
        Ok(Self(runs.collect::<Result<_>>()?))
    }

    /// Returns, for each run: step, RMSE in metres and REL on held-out frames.
    pub fn held_out(&self) -> Vec<Vec<(f64, f64, f64)>> {
        self.0.iter().map(|run| run.held_out.clone()).collect()
    }

    /// Writes a page with the curves and the table.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_html(&self, path: &Path) -> Result<()> {
        let names: Vec<String> = self.0.iter().map(|run| run.name.clone()).collect();
        let chart = |title: &'static str, y_label: &'static str, points: fn(&Run) -> Points| {
            let lines = self.0.iter().enumerate().map(|(colour, run)| Line {
                colour,
                points: points(run),
                ..Line::default()
            });
            Chart {
                title,
                x_label: "step",
                y_label,
                scales: AxisScales::Linear,
                lines: lines.collect(),
            }
        };
        let held_out = "Frames kept out of training, 500 points";
        let charts = [
            chart("Loss", "loss", |run| run.loss.clone()),
            chart("Training batches", "RMSE, m", |run| run.rmse.clone()),
            chart(held_out, "RMSE, m", |run| {
                run.held_out.iter().map(|p| (p.0, p.1)).collect()
            }),
        ];
        write_charts(path, "Training", &names, &charts, &self.to_string())
    }
}

impl Display for Training {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let width = self.0.iter().map(|run| run.name.len()).max().unwrap_or(0);
        let width = width.max(3);
        writeln!(
            f,
            "{:<width$} {:>7} {:>8} {:>8} {:>13} {:>8} {:>8}",
            "run", "steps", "s/step", "loss", "held-out RMSE", "REL", "best at"
        )?;
        for run in &self.0 {
            let loss = run.loss.last().map_or(f64::NAN, |p| p.1);
            write!(
                f,
                "{:<width$} {:>7} {:>8.2} {loss:>8.4}",
                run.name, run.steps, run.seconds
            )?;
            let best = run.held_out.iter().min_by(|a, b| a.1.total_cmp(&b.1));
            match (run.held_out.last(), best) {
                (Some((_, rmse, rel)), Some((step, ..))) => {
                    writeln!(f, " {rmse:>13.4} {rel:>8.4} {step:>8}")?;
                }
                _ => writeln!(f, " {:>13} {:>8} {:>8}", "-", "-", "-")?,
            }
        }
        Ok(())
    }
}

impl Run {
    fn read(folder: &Path) -> Result<Self> {
        let path = folder.join("metrics.jsonl");
        let text = std::fs::read_to_string(&path).map_err(|e| Error::read(&path, e))?;
        let entries = text.lines().map(serde_json::from_str);
        let entries: Vec<Entry> = entries
            .collect::<std::result::Result<_, _>>()
            .map_err(|e| {
                let what = format!("`{}` is not the record of a training run", path.display());
                Error::new(Cause::Format, what).because(e)
            })?;
        let name = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
        let name = name.file_name().unwrap_or_default().to_string_lossy();
        Self::of(name.into_owned(), &entries).ok_or_else(|| {
            Error::config(format!("`{}` has no step yet", path.display()))
                .hint("give the folder of a run that has begun")
        })
    }

    fn of(name: String, entries: &[Entry]) -> Option<Self> {
        let steps = entries.iter().map(|e| e.step).max()?;
        let span = steps.div_ceil(MAX_POINTS).max(1);
        let curve = |of: &dyn Fn(&Entry) -> Option<f64>| {
            let values: Vec<(usize, f64)> = entries
                .iter()
                .filter_map(|e| Some((e.step, of(e)?)))
                .collect();
            let spans = values.chunk_by(|a, b| (a.0 - 1) / span == (b.0 - 1) / span);
            let mean = |some: &[(usize, f64)]| {
                let count = some.len() as f64;
                let step = some.iter().map(|v| v.0 as f64).sum::<f64>() / count;
                (step, some.iter().map(|v| v.1).sum::<f64>() / count)
            };
            spans.map(mean).collect::<Vec<(f64, f64)>>()
        };
        let loss = curve(&|e| e.loss);
        let squares = curve(&|e| e.rmse.map(|v| v * v));
        let seconds: Vec<f64> = entries.iter().filter_map(|e| e.seconds).collect();
        let held_out = entries.iter().filter_map(|e| {
            let scores = e.held_out.as_ref()?;
            Some((e.step as f64, scores.rmse, scores.rel))
        });
        (!loss.is_empty()).then(|| Self {
            name,
            steps,
            seconds: seconds.iter().sum::<f64>() / seconds.len().max(1) as f64,
            rmse: squares.into_iter().map(|(s, v)| (s, v.sqrt())).collect(),
            held_out: held_out.collect(),
            loss,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fmt::Write as _;

    #[test]
    fn curves_are_means_over_spans() {
        let folder = tempfile::tempdir().unwrap();
        let mut lines = String::new();
        for step in 1..=120 {
            let _ = writeln!(
                lines,
                r#"{{"step":{step},"loss":{},"l1":0.1,"rmse":0.3,"rate":1.0,"seconds":2.0}}"#,
                if step % 2 == 0 { 1.0 } else { 3.0 }
            );
            if step % 60 == 0 {
                let rmse = 30.0 / f64::from(step);
                let _ = writeln!(
                    lines,
                    r#"{{"step":{step},"held_out":{{"rmse":{rmse},"rel":0.1}}}}"#
                );
            }
        }
        std::fs::write(folder.path().join("metrics.jsonl"), lines).unwrap();
        let training = Training::read(&[folder.path()]).unwrap();
        let run = &training.0[0];
        assert_eq!(run.steps, 120);
        assert_eq!(run.loss.len(), 60);
        assert_eq!(run.loss[0], (1.5, 2.0));
        assert!((run.rmse[7].1 - 0.3).abs() < 1e-12);
        assert_eq!(run.held_out, [(60.0, 0.5, 0.1), (120.0, 0.25, 0.1)]);
        let text = training.to_string();
        assert!(text.contains("0.2500"), "{text}");
        let page = folder.path().join("page.html");
        training.write_html(&page).unwrap();
        let page = std::fs::read_to_string(page).unwrap();
        assert_eq!(page.matches("<polyline").count(), 3);
    }

    #[test]
    fn folders_without_a_run_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert!(Training::read(&[folder.path()]).is_err());
        std::fs::write(folder.path().join("metrics.jsonl"), "").unwrap();
        let error = Training::read(&[folder.path()]).unwrap_err();
        assert!(error.to_string().contains("no step"), "{error}");
        std::fs::write(folder.path().join("metrics.jsonl"), "{}\n").unwrap();
        assert!(Training::read(&[folder.path()]).is_err());
    }
}
