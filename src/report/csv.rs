//! One line per frame and method.

use super::Report;
use crate::data::write_atomically;
use crate::error::Result;
use std::path::Path;

impl Report {
    /// Writes `frame,method,points,rmse_m,mae_m,rel,delta1,delta2,delta3`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        write_atomically(path, |out| {
            writeln!(
                out,
                "frame,method,points,rmse_m,mae_m,rel,delta1,delta2,delta3"
            )?;
            for frame in &self.frames {
                for (method, s) in self.methods.iter().zip(&frame.scores) {
                    writeln!(
                        out,
                        "{},{method},{},{},{},{},{},{},{}",
                        quoted(&frame.frame),
                        frame.points,
                        s.rmse,
                        s.mae,
                        s.rel,
                        s.delta1,
                        s.delta2,
                        s.delta3
                    )?;
                }
            }
            Ok(())
        })
    }
}

/// A field as RFC 4180 wants it.
fn quoted(field: &str) -> String {
    if field.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", field.replace('"', "\"\""))
    } else {
        field.to_owned()
    }
}
