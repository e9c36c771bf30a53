//! Bar charts.

use super::chart::{COLOURS, ticks, x_axis};
use super::drawing::{Drawing, escaped};
use std::fmt::Write as _;

/// A bar chart; each bar has several parts, from left to right.
#[derive(Clone, Debug)]
pub struct Bars<'a> {
    /// Title of the chart.
    pub title: &'a str,
    /// Unit of the lengths.
    pub unit: &'a str,
    /// Names of the parts.
    pub parts: &'a [&'a str],
    /// Name of each bar, and the length of each part.
    pub rows: Vec<(String, Vec<f64>)>,
}

const WIDTH: f64 = 640.0;
const LEFT: f64 = 190.0;
const RIGHT: f64 = 60.0;
const TOP: f64 = 50.0;
const ROW: f64 = 26.0;

impl Bars<'_> {
    /// Draws the chart.
    pub fn draw(&self) -> Drawing {
        let total = |row: &(String, Vec<f64>)| row.1.iter().sum::<f64>();
        let max_total = self
            .rows
            .iter()
            .map(total)
            .fold(0.0, f64::max)
            .max(f64::MIN_POSITIVE);
        let x = |value: f64| LEFT + value / max_total * (WIDTH - LEFT - RIGHT);
        let bottom = TOP + ROW * self.rows.len() as f64;
        let mut body = format!(
            "<text class='title' x='10' y='16'>{}</text>",
            escaped(self.title)
        );
        let mut left = LEFT;
        for (part, colour) in self.parts.iter().zip(COLOURS) {
            let _ = write!(
                body,
                "<rect x='{left}' y='28' width='12' height='10' fill='{colour}'/>\
                 <text x='{}' y='37'>{}</text>",
                left + 17.0,
                escaped(part)
            );
            left += 90.0;
        }
        x_axis(&mut body, &ticks(0.0, max_total), x, TOP, bottom);
        for (index, row) in self.rows.iter().enumerate() {
            let top = TOP + ROW * index as f64;
            let _ = write!(
                body,
                "<text x='{}' y='{}' text-anchor='end'>{}</text>",
                LEFT - 8.0,
                top + 17.0,
                escaped(&row.0)
            );
            let mut start = 0.0;
            for (length, colour) in row.1.iter().zip(COLOURS) {
                let _ = write!(
                    body,
                    "<rect x='{:.1}' y='{}' width='{:.1}' height='{}' fill='{colour}'/>",
                    x(start),
                    top + 4.0,
                    x(start + length) - x(start),
                    ROW - 8.0
                );
                start += length;
            }
            let _ = write!(
                body,
                "<text x='{:.1}' y='{}'>{start:.0} {}</text>",
                x(start) + 5.0,
                top + 17.0,
                self.unit
            );
        }
        Drawing {
            title: self.title.to_owned(),
            width: WIDTH,
            height: bottom + 24.0,
            body,
        }
    }
}
