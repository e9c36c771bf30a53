//! Line charts as SVG.

use super::drawing::{Drawing, escaped};
use std::fmt::Write as _;

/// A chart of several lines over one axis.
#[derive(Clone, Debug)]
pub struct Chart<'a> {
    /// What it shows.
    pub title: &'a str,
    /// The horizontal axis, with its unit.
    pub across: &'a str,
    /// The vertical axis, with its unit.
    pub up: &'a str,
    /// Whether the horizontal axis is logarithmic.
    pub logarithmic: bool,
    /// What is drawn; lines with names are listed beside the chart.
    pub lines: Vec<Line>,
}

/// A line of a chart.
#[derive(Clone, Debug, Default)]
pub struct Line {
    /// What it shows; without a name, something else tells colours apart.
    pub name: Option<String>,
    /// Its place among the colours.
    pub colour: usize,
    /// Whether it is a limit or somebody else's, drawn dashed, rather than a measurement.
    pub dashed: bool,
    /// From left to right.
    pub points: Vec<(f64, f64)>,
}

/// Colours of the lines, apart for colour-blind eyes as well (Okabe and Ito 2008).
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
/// Beside the chart, for names.
const NAMES: f64 = 150.0;
/// Lines of no more points than this show where they are.
const MARKED: usize = 24;

impl Chart<'_> {
    /// The chart as an `svg` element; nothing if there is nothing to show.
    pub(super) fn svg(&self) -> String {
        self.draw().inline()
    }

    /// The chart as a picture.
    pub fn draw(&self) -> Drawing {
        let all = || self.lines.iter().flat_map(|line| &line.points);
        let range = |of: fn(&(f64, f64)) -> f64| {
            all()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
                    (low.min(v), high.max(v))
                })
        };
        let (mut left, mut right) = range(|p| p.0);
        let (_, mut top) = range(|p| p.1);
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
        top = if top > 0.0 { 1.05 * top } else { 1.0 };
        let across = |v: f64| if self.logarithmic { v.ln() } else { v };
        let x = |v: f64| {
            let share = (across(v) - across(left)) / (across(right) - across(left));
            LEFT + share * (WIDTH - LEFT - RIGHT)
        };
        let y = |v: f64| HEIGHT - BOTTOM - v / top * (HEIGHT - BOTTOM - TOP);
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
            escaped(self.across),
            0.5 * (TOP + floor),
            escaped(self.up)
        );
        for tick in ticks(0.0, top) {
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
        let marks = if self.logarithmic {
            logarithmic_ticks(left, right)
        } else {
            ticks(left, right)
        };
        for tick in marks {
            let at = x(tick);
            let _ = write!(
                svg,
                "<path class='grid' d='M{at:.1} {TOP}V{floor}'/>\
                 <text x='{at:.1}' y='{}' text-anchor='middle'>{}</text>",
                floor + 15.0,
                number(tick)
            );
        }
        for line in &self.lines {
            let path: Vec<String> = line
                .points
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
            if line.points.len() <= MARKED {
                for &(u, v) in &line.points {
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
        for (place, (line, name)) in names.enumerate() {
            let (at, high) = (WIDTH - RIGHT + 12.0, TOP + 8.0 + 17.0 * place as f64);
            let _ = write!(
                svg,
                "<path d='M{at} {high}h18' stroke='{}' stroke-width='2.4'{}/>\
                 <text x='{}' y='{}'>{}</text>",
                COLOURS[line.colour % COLOURS.len()],
                dashes(line.dashed),
                at + 24.0,
                high + 4.0,
                escaped(name)
            );
        }
        drawing
    }
}

fn dashes(dashed: bool) -> &'static str {
    if dashed {
        " stroke-dasharray='5 4'"
    } else {
        ""
    }
}

/// Round numbers between two values: about five.
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

/// Powers of ten, with 2 and 5 between them where there is room.
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

pub(super) fn number(value: f64) -> String {
    let text = format!("{value:.4}");
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks(0.0, 1.05), [0.0, 0.5, 1.0]);
        assert_eq!(ticks(0.0, 0.9), [0, 1, 2, 3, 4].map(|i| f64::from(i) * 0.2));
        assert_eq!(logarithmic_ticks(0.7, 10.0), [1.0, 2.0, 5.0, 10.0]);
        assert_eq!(number(3.0 * 0.2), "0.6");
        assert_eq!(number(20.0), "20");
    }
}
