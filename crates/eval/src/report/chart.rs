//! Line charts as SVG.

use super::drawing::{Drawing, escaped};
use std::fmt::Write as _;

/// A line chart.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// Title of the chart.
    pub title: &'a str,
    /// Label of the horizontal axis, with its unit.
    pub x_label: &'a str,
    /// Label of the vertical axis, with its unit.
    pub y_label: &'a str,
    /// Scales of the axes.
    pub scales: AxisScales,
    /// Lines of the chart; named ones are listed beside the chart.
    pub lines: Vec<Line>,
}

/// Scales of the axes of a chart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisScales {
    /// Both linear, the vertical one from 0.
    Linear,
    /// Horizontal logarithmic, vertical linear from 0.
    LogX,
    /// Both logarithmic. Values that are not positive are left out.
    LogLog,
}

/// A line of a chart.
#[derive(Clone, Debug, Default)]
pub struct Line {
    /// Name in the legend; a line without one is not listed.
    pub name: Option<String>,
    /// Index of its colour.
    pub colour: usize,
    /// Whether it is drawn dashed, for limits and published results rather than measurements.
    pub dashed: bool,
    /// Points from left to right.
    pub points: Vec<(f64, f64)>,
}

/// Colours of the lines, distinguishable with colour blindness (Okabe and Ito 2008).
pub(super) const COLOURS: [&str; 10] = [
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#8a8a00",
    "#8c564b", "#999999",
];

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 300.0;
const LEFT: f64 = 58.0;
const BOTTOM: f64 = 42.0;
const TOP: f64 = 28.0;
const RIGHT: f64 = 22.0;
/// Width beside the chart for names.
const NAMES: f64 = 150.0;
/// Largest number of points of a line with markers.
const MARKED: usize = 24;

impl Chart<'_> {
    /// Draws the chart.
    pub fn draw(&self) -> Drawing {
        let visible = |line: &Line| -> Vec<(f64, f64)> {
            let positive = |&(_, v): &(f64, f64)| self.scales != AxisScales::LogLog || v > 0.0;
            line.points.iter().copied().filter(positive).collect()
        };
        let all = || self.lines.iter().flat_map(visible);
        let range = |of: fn((f64, f64)) -> f64| {
            all()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                    (low.min(v), high.max(v))
                })
        };
        let (mut left, mut right) = range(|p| p.0);
        let (mut low, mut top) = range(|p| p.1);
        let named = self.lines.iter().any(|line| line.name.is_some());
        let mut drawing = Drawing {
            title: self.title.to_owned(),
            width: if named { WIDTH + NAMES } else { WIDTH },
            height: HEIGHT,
            body: String::new(),
        };
        if !(left.is_finite() && top.is_finite()) {
            return drawing;
        }
        if right <= left {
            (left, right) = (0.5 * left, 2.0 * right);
        }
        let [log_x, log_y] = match self.scales {
            AxisScales::Linear => [false; 2],
            AxisScales::LogX => [true, false],
            AxisScales::LogLog => [true; 2],
        };
        top = if top > 0.0 { 1.05 * top } else { 1.0 };
        low = if log_y { low / 1.05 } else { 0.0 };
        let x = |v: f64| LEFT + share(v, (left, right), log_x) * (WIDTH - LEFT - RIGHT);
        let y = |v: f64| HEIGHT - BOTTOM - share(v, (low, top), log_y) * (HEIGHT - BOTTOM - TOP);
        let axis_ticks = |by_log, low, high| {
            if by_log {
                logarithmic_ticks(low, high)
            } else {
                ticks(low, high)
            }
        };
        let svg = &mut drawing.body;
        let floor = HEIGHT - BOTTOM;
        let middle = 0.5 * (LEFT + WIDTH - RIGHT);
        let _ = write!(
            svg,
            "<text class='title' x='{LEFT}' y='16'>{}</text>\
             <text x='{middle}' y='{}' text-anchor='middle'>{}</text>\
             <text transform='translate(14 {}) rotate(-90)' text-anchor='middle'>{}</text>",
            escaped(self.title),
            HEIGHT - 6.0,
            escaped(self.x_label),
            0.5 * (TOP + floor),
            escaped(self.y_label)
        );
        for tick in axis_ticks(log_y, low, top) {
            let at = y(tick);
            let _ = write!(
                svg,
                "<path class='grid' d='M{LEFT} {at:.1}H{}'/>\
                 <text x='{}' y='{:.1}' text-anchor='end'>{}</text>",
                WIDTH - RIGHT,
                LEFT - 5.0,
                at + 4.0,
                number(tick)
            );
        }
        x_axis(svg, &axis_ticks(log_x, left, right), x, TOP, floor);
        for line in &self.lines {
            let points = visible(line);
            let path: Vec<String> = points
                .iter()
                .map(|&(u, v)| format!("{:.1} {:.1}", x(u), y(v)))
                .collect();
            let colour = COLOURS[line.colour % COLOURS.len()];
            let dashes = dashes(line.dashed);
            let _ = write!(
                svg,
                "<polyline points='{}' fill='none' stroke='{colour}' stroke-width='1.8'{dashes}/>",
                path.join(" ")
            );
            if points.len() <= MARKED {
                for (u, v) in points {
                    let _ = write!(
                        svg,
                        "<circle cx='{:.1}' cy='{:.1}' r='2.6' fill='{colour}'/>",
                        x(u),
                        y(v)
                    );
                }
            }
        }
        let names = self
            .lines
            .iter()
            .filter_map(|line| Some((line, line.name.as_ref()?)));
        for (index, (line, name)) in names.enumerate() {
            let (left, y) = (WIDTH - RIGHT + 12.0, TOP + 8.0 + 17.0 * index as f64);
            let _ = write!(
                svg,
                "<path d='M{left} {y}h18' stroke='{}' stroke-width='2.4'{}/>\
                 <text x='{}' y='{}'>{}</text>",
                COLOURS[line.colour % COLOURS.len()],
                dashes(line.dashed),
                left + 24.0,
                y + 4.0,
                escaped(name)
            );
        }
        drawing
    }
}

/// Returns the relative position of a value between two limits.
fn share(value: f64, (low, high): (f64, f64), by_log: bool) -> f64 {
    let scaled = |v: f64| if by_log { v.ln() } else { v };
    (scaled(value) - scaled(low)) / (scaled(high) - scaled(low))
}

fn dashes(dashed: bool) -> &'static str {
    if dashed {
        " stroke-dasharray='5 4'"
    } else {
        ""
    }
}

/// Returns about five round numbers between two values.
pub(super) fn ticks(low: f64, high: f64) -> Vec<f64> {
    let rough = (high - low) / 5.0;
    let power = 10_f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|m| m * power)
        .into_iter()
        .find(|step| *step >= rough)
        .unwrap_or(rough);
    let first = (low / step).ceil() as i64;
    let last = (high / step).floor() as i64;
    (first..=last).map(|i| i as f64 * step).collect()
}

/// Returns powers of ten, with 2 and 5 between them if there is room.
fn logarithmic_ticks(low: f64, high: f64) -> Vec<f64> {
    let decades = (high / low).log10();
    let digits: &[f64] = if decades < 3.0 {
        &[1.0, 2.0, 5.0]
    } else {
        &[1.0]
    };
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    powers
        .flat_map(|p| digits.iter().map(move |d| d * 10_f64.powi(p)))
        .filter(|v| (low..=high).contains(v))
        .collect()
}

/// Adds vertical grid lines at `ticks`, from `top` to `bottom`, with their values below. `x` maps values to positions.
pub(super) fn x_axis(
    svg: &mut String,
    ticks: &[f64],
    x: impl Fn(f64) -> f64,
    top: f64,
    bottom: f64,
) {
    for &tick in ticks {
        let at = x(tick);
        let _ = write!(
            svg,
            "<path class='grid' d='M{at:.1} {top}V{bottom}'/>\
             <text x='{at:.1}' y='{}' text-anchor='middle'>{}</text>",
            bottom + 15.0,
            number(tick)
        );
    }
}

fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_logarithmic_axis_has_equal_steps_for_equal_ratios() {
        let shares = [0.05, 0.5, 5.0].map(|v| share(v, (0.05, 5.0), true));
        assert!((shares[1] - 0.5).abs() < 1e-12 && shares[0] == 0.0 && shares[2] == 1.0);
        let chart = Chart {
            title: "RMSE",
            x_label: "points",
            y_label: "m",
            scales: AxisScales::LogLog,
            lines: vec![Line {
                points: vec![(5.0, 1.0), (50.0, 0.0), (500.0, 0.1)],
                ..Line::default()
            }],
        };
        let drawing = chart.draw();
        // The point with error 0 is left out.
        assert_eq!(drawing.body.matches("<circle").count(), 2);
        assert!(!drawing.body.contains("NaN") && !drawing.body.contains("inf"));
    }

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(0.0, 1.05), [0.0, 0.5, 1.0]);
        assert_eq!(ticks(0.0, 0.9), [0, 1, 2, 3, 4].map(|i| f64::from(i) * 0.2));
        assert_eq!(logarithmic_ticks(0.7, 10.0), [1.0, 2.0, 5.0, 10.0]);
        assert_eq!(logarithmic_ticks(0.03, 40.0), [0.1, 1.0, 10.0]);
        assert_eq!(number(3.0 * 0.2), "0.6");
        assert_eq!(number(20.0), "20");
    }
}
