//! Scores as CSV, one line per frame, seed and method.

use super::EvaluationReport;
use crate::data::write_atomically;
use crate::metrics::Metric;
use lsdc_files::error::Result;
use std::path::Path;

impl EvaluationReport {
    /// Writes `frame,seed,method,points` and every metric; missing values are empty.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        write_atomically(path, |out| {
            let names = Metric::ALL.map(Metric::key).join(",");
            writeln!(out, "frame,seed,method,points,{names}")?;
            for ((frame, seed), scores) in &self.frames {
                for (method, s) in self.heading.methods.iter().zip(&scores.scores) {
                    let (frame, method) = (quoted(frame), quoted(method));
                    write!(out, "{frame},{seed},{method},{}", scores.points)?;
                    for metric in Metric::ALL {
                        match s[metric] {
                            value if value.is_finite() => write!(out, ",{value}")?,
                            _ => write!(out, ",")?,
                        }
                    }
                    writeln!(out)?;
                }
            }
            Ok(())
        })
    }
}

/// Quotes a field if RFC 4180 requires it.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}
