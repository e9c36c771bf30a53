//! The table for people.

use super::Report;
use std::fmt::{Display, Formatter, Result};

impl Display for Report {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let count = self.frames.len();
        writeln!(f, "dataset   {}, {count} frames", self.heading.dataset)?;
        writeln!(f, "protocol  {}", self.heading.protocol)?;
        writeln!(f, "points    {}", self.heading.points)?;
        writeln!(
            f,
            "averaged  per frame over pixels with a true depth, then over frames"
        )?;
        writeln!(f)?;
        writeln!(
            f,
            "{:<10} {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}",
            "method", "RMSE m", "MAE m", "REL", "d1.25 %", "^2 %", "^3 %"
        )?;
        for (method, s) in self.means() {
            let [d1, d2, d3] = [s.delta1, s.delta2, s.delta3].map(|d| 100.0 * d);
            writeln!(
                f,
                "{method:<10} {:>8.4} {:>8.4} {:>8.4} {d1:>8.2} {d2:>8.2} {d3:>8.2}",
                s.rmse, s.mae, s.rel
            )?;
        }
        Ok(())
    }
}
