//! The report as text.

use super::{EvaluationReport, Mean};
use crate::data::Environment;
use crate::metrics::{Metric, SLICES};
use std::fmt::{Display, Formatter, Result};

/// Metrics of each table.
pub(super) const TABLES: [&[Metric]; 2] = [
    &[
        Metric::Rmse,
        Metric::Mae,
        Metric::Irmse,
        Metric::Imae,
        Metric::Rel,
        Metric::Log10,
        Metric::RmseLog,
        Metric::See,
    ],
    &[
        Metric::Delta102,
        Metric::Delta105,
        Metric::Delta110,
        Metric::Delta1,
        Metric::Delta2,
        Metric::Delta3,
    ],
];

impl EvaluationReport {
    /// Returns the lines above the tables: names and texts.
    pub(super) fn preface(&self) -> Vec<(&'static str, String)> {
        let heading = &self.heading;
        let count = self.count();
        let frames = match heading.frames {
            all if all == count => format!("{count} frames"),
            all => format!("{count} of {all} frames"),
        };
        let seeds: Vec<String> = heading.seeds.iter().map(u64::to_string).collect();
        let noise = heading.noise.as_ref().map(|n| format!(", {n}"));
        let noise = noise.unwrap_or_default();
        let dataset = format!("{}, {frames}: {}", heading.dataset, heading.found);
        let points = format!("{}{noise}, seed {}", heading.points, seeds.join(", "));
        let spread = "mean over seeds; +- is the standard deviation over them";
        let spread = (seeds.len() > 1).then(|| spread.to_owned());
        let lines = [
            ("dataset", Some(dataset)),
            ("protocol", Some(heading.protocol.clone())),
            ("steps", Some(heading.steps.clone())),
            ("points", Some(points)),
            ("held out", heading.hold_out.clone()),
            ("weights", heading.weights.clone()),
            ("limits", Some(heading.limits.clone())),
            ("averaged", Some(heading.rules.to_string())),
            ("", spread),
        ];
        let lines = lines.into_iter();
        lines
            .filter_map(|(name, text)| Some((name, text?)))
            .collect()
    }

    /// Describes the calibration of the predicted errors of each method.
    pub(super) fn predicted_errors(&self) -> Vec<String> {
        let pairs = self.heading.methods.iter().zip(&self.sums);
        pairs
            .filter_map(|(method, sums)| {
                let uncertainty = sums.uncertainty.as_ref()?;
                let (one, two) = uncertainty.coverage();
                let curve = uncertainty.sparsification();
                Some(format!(
                    "{method}: intervals of 68.3 % hold {:.1} % of errors, those of 95.4 % {:.1} %; negative \
                     log-likelihood {:.3}; RMSE over all pixels {:.4} m, without the most uncertain quarter {:.4} m, \
                     half {:.4} m; AUSE {:.3} of the RMSE, {:.3} of that of a random order",
                    100.0 * one,
                    100.0 * two,
                    uncertainty.neg_log_likelihood(),
                    curve[0].1,
                    curve[SLICES / 4].1,
                    curve[SLICES / 2].1,
                    uncertainty.ause(),
                    uncertainty.ause_of_random()
                ))
            })
            .collect()
    }

    /// Describes the differences from the first method.
    pub(super) fn comparisons(&self) -> Vec<String> {
        let first = self.heading.methods.first().map_or("", String::as_str);
        self.differences(Metric::Rmse)
            .into_iter()
            .filter_map(|(method, difference)| {
                let d = difference?;
                Some(format!(
                    "{method} - {first}: RMSE {:+.4} m (95 % from {:+.4} to {:+.4}), {method} is \
                     better on {:.0} % of {} frames",
                    d.mean,
                    d.low,
                    d.high,
                    100.0 * d.smaller,
                    d.pairs
                ))
            })
            .collect()
    }
}

impl Display for EvaluationReport {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        for (name, text) in self.preface() {
            writeln!(f, "{name:<9} {text}")?;
        }
        tables(f, &self.means(None))?;
        let places = self.places();
        if places.len() > 1 {
            for place in places {
                let name = match place {
                    Environment::Indoor => "indoor",
                    Environment::Outdoor => "outdoor",
                };
                write!(f, "\n{name}:")?;
                tables(f, &self.means(Some(place)))?;
            }
        }
        for table in self.by_scene() {
            write!(f, "\n{table}")?;
        }
        if let Some(about) = self.about_ranges() {
            writeln!(f, "\n{about}")?;
        }
        for table in self.by_depth() {
            write!(f, "\n{table}")?;
        }
        for line in self.predicted_errors() {
            writeln!(f, "\n{line}")?;
        }
        let comparisons = self.comparisons();
        if !comparisons.is_empty() {
            writeln!(f)?;
        }
        comparisons
            .iter()
            .try_for_each(|line| writeln!(f, "{line}"))
    }
}

fn tables(f: &mut Formatter<'_>, means: &[Mean]) -> Result {
    let width = means
        .iter()
        .map(|m| m.method.len())
        .max()
        .unwrap_or(0)
        .max(8);
    let repeated = means.iter().any(|m| m.deviation[Metric::Rmse].is_finite());
    for metrics in TABLES {
        write!(f, "\n{:<width$}", "method")?;
        for metric in metrics {
            let unit = metric.unit();
            let name = match unit {
                "" => metric.label().to_owned(),
                _ => format!("{} {unit}", metric.label()),
            };
            write!(f, " {name:>10}")?;
            if repeated && *metric == Metric::Rmse {
                write!(f, " {:>8}", "+-")?;
            }
        }
        writeln!(f)?;
        for mean in means {
            write!(f, "{:<width$}", mean.method)?;
            for metric in metrics {
                write!(f, " {:>10}", formatted(*metric, mean.mean[*metric]))?;
                if repeated && *metric == Metric::Rmse {
                    write!(f, " {:>8}", formatted(*metric, mean.deviation[*metric]))?;
                }
            }
            writeln!(f)?;
        }
    }
    Ok(())
}

/// Formats a value with its significant digits.
pub(super) fn formatted(metric: Metric, value: f64) -> String {
    if !value.is_finite() {
        "-".to_owned()
    } else if metric.is_share() {
        format!("{:.2}", 100.0 * value)
    } else if metric.unit() == "1/km" {
        format!("{value:.2}")
    } else {
        format!("{value:.4}")
    }
}
