//! The report as a self-contained page: tables, charts, and pictures of example frames.

use super::chart::{AxisScales, COLOURS, Chart, Line};
use super::colour::{coloured, errors};
use super::drawing::{data_url, escaped};
use super::text::{TABLES, formatted};
use super::{EvaluationReport, Failure, Mean};
use crate::data::{DepthMap, Environment, write_atomically};
use crate::metrics::{Axis, Bin, Metric, UncertaintyScores};
use crate::window;
use image::RgbImage;
use lsdc_files::error::Result;
use std::fmt::Write as _;
use std::path::Path;

/// A frame shown in a report.
#[derive(Clone, Debug)]
pub struct ExampleFrame {
    /// Why it is shown: `worst`, `median` or `best`.
    pub role: &'static str,
    /// The frame's name.
    pub frame: String,
    /// The colour image.
    pub rgb: RgbImage,
    /// Sparse points given to the methods.
    pub sparse: DepthMap,
    /// The true depth.
    pub truth: DepthMap,
    /// Each method's name, RMSE in metres, and prediction.
    pub predictions: Vec<(String, f64, DepthMap)>,
}

impl EvaluationReport {
    /// Writes the page.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_html(&self, path: &Path, examples: &[ExampleFrame]) -> Result<()> {
        let page = self.to_html(examples);
        write_atomically(path, |out| out.write_all(page.as_bytes()))
    }

    /// Returns the page.
    pub fn to_html(&self, examples: &[ExampleFrame]) -> String {
        let mut page = begin(&format!("Depth completion on {}", self.heading.dataset));
        page.push_str("<table class='preface'>");
        for (name, text) in self.preface() {
            let _ = write!(page, "<tr><td>{name}</td><td>{}</td></tr>", markup(&text));
        }
        page.push_str("</table>\n<h2>Errors</h2>");
        page.push_str(&tables(&self.means(None)));
        let places = self.places();
        if places.len() > 1 {
            for place in places {
                let name = match place {
                    Environment::Indoor => "Indoor",
                    Environment::Outdoor => "Outdoor",
                };
                let _ = write!(page, "<h3>{name}</h3>{}", tables(&self.means(Some(place))));
            }
        }
        self.by_scene()
            .iter()
            .for_each(|table| page.push_str(&table.html()));
        if let Some(about) = self.about_ranges() {
            let _ = write!(page, "<h2>Errors by depth</h2><p>{}.</p>", markup(&about));
        }
        self.by_depth()
            .iter()
            .for_each(|table| page.push_str(&table.html()));
        for line in self
            .comparisons()
            .into_iter()
            .chain(self.predicted_errors())
        {
            let _ = write!(page, "<p>{}.</p>", markup(&line));
        }
        page.push_str("\n<h2>Where the errors are</h2>");
        page.push_str(&self.charts());
        if !examples.is_empty() {
            page.push_str("\n<h2>Frames</h2>");
        }
        for example in examples {
            page.push_str(&example_html(example));
        }
        page.push_str(&failed(&self.failures));
        page + END
    }

    fn charts(&self) -> String {
        let methods = &self.heading.methods;
        let lines = |of: &dyn Fn(usize) -> Vec<(f64, f64)>| -> Vec<Line> {
            let line = |colour: usize| Line {
                colour,
                points: of(colour),
                ..Line::default()
            };
            (0..methods.len()).map(line).collect()
        };
        // A mean over few pixels is noisy, so that a bin needs a thousandth of all pixels.
        let curve = |axis: Axis, method: usize| -> Vec<(f64, f64)> {
            let bins = self.sums[method].profile.along(axis);
            let all: u64 = bins.iter().map(|b| b.pixels).sum();
            bins.iter()
                .enumerate()
                .filter(|(_, bin)| 1000 * bin.pixels >= all)
                .filter_map(|(i, bin)| Some((axis.middle(i), bin.mean()?)))
                .collect()
        };
        let sizes = |method: usize| -> Vec<(f64, f64)> {
            let bins = self.sums[method].profile.along(Axis::Error);
            let all: u64 = bins.iter().map(|b| b.pixels).sum();
            let share = |bin: &Bin| 100.0 * bin.pixels as f64 / all.max(1) as f64;
            bins.iter()
                .enumerate()
                .map(|(i, bin)| (Axis::Error.middle(i), share(bin)))
                .collect()
        };
        let frames = |method: usize| -> Vec<(f64, f64)> {
            let scores = self.by_frame(method);
            let mut rmse: Vec<f64> = scores.values().map(|s| s[Metric::Rmse]).collect();
            rmse.sort_by(f64::total_cmp);
            let count = rmse.len() as f64;
            let share = |i: usize| 100.0 * (i as f64 + 0.5) / count;
            rmse.into_iter()
                .enumerate()
                .map(|(i, v)| (share(i), v))
                .collect()
        };
        // Sorted by the prediction, and ideally.
        let mut sparsification = Vec::new();
        for (colour, sums) in self.sums.iter().enumerate() {
            let curve = sums
                .uncertainty
                .iter()
                .flat_map(UncertaintyScores::sparsification);
            let (found, best) = curve
                .map(|(share, found, best)| ((100.0 * share, found), (100.0 * share, best)))
                .unzip();
            for (dashed, points) in [(false, found), (true, best)] {
                sparsification.push(Line {
                    colour,
                    dashed,
                    points,
                    ..Line::default()
                });
            }
        }
        let mut calibration = vec![Line {
            colour: 0,
            dashed: true,
            points: vec![(0.0, 0.0), (100.0, 100.0)],
            ..Line::default()
        }];
        for (colour, sums) in self.sums.iter().enumerate() {
            let pairs = sums
                .uncertainty
                .iter()
                .flat_map(UncertaintyScores::calibration);
            calibration.push(Line {
                colour,
                points: pairs.map(|(a, b)| (100.0 * a, 100.0 * b)).collect(),
                ..Line::default()
            });
        }
        if self.sums.iter().all(|sums| sums.uncertainty.is_none()) {
            calibration.clear();
        }
        let charts = [
            Chart {
                title: "Errors that intervals hold (dashed: ideal)",
                x_label: "level of the interval, %",
                y_label: "errors within, %",
                scales: AxisScales::Linear,
                lines: calibration,
            },
            Chart {
                title: "RMSE of the pixels that are left (dashed: at best)",
                x_label: "most uncertain pixels removed, %",
                y_label: "RMSE, m",
                scales: AxisScales::Linear,
                lines: sparsification,
            },
            Chart {
                title: "Mean absolute error against depth",
                x_label: "true depth, m",
                y_label: "MAE, m",
                scales: AxisScales::LogX,
                lines: lines(&|i| curve(Axis::Depth, i)),
            },
            Chart {
                title: "Mean absolute error against distance to a point",
                x_label: "distance to the nearest point, pixels (left end: at a point)",
                y_label: "MAE, m",
                scales: AxisScales::LogX,
                lines: lines(&|i| curve(Axis::Distance, i)),
            },
            Chart {
                title: "How large the errors are",
                x_label: "absolute error, m (half octaves)",
                y_label: "pixels, %",
                scales: AxisScales::LogX,
                lines: lines(&sizes),
            },
            Chart {
                title: "RMSE of the frames, from best to worst",
                x_label: "frames, %",
                y_label: "RMSE, m",
                scales: AxisScales::Linear,
                lines: lines(&frames),
            },
        ];
        charts_with_legend(methods, &charts)
    }
}

/// Converts the marks of plain text to elements: `names`, powers (`1.25^2`) and the window of a metric (`SEE_3`).
pub(super) fn markup(text: &str) -> String {
    let text = escaped(text);
    let mut html = String::new();
    let mut remaining = text.as_str();
    loop {
        let plain = remaining.find('`').unwrap_or(remaining.len());
        let code = remaining[plain..]
            .get(1..)
            .and_then(|after| after.split_once('`'));
        let Some((code, after)) = code else {
            return html + &powers_and_windows(remaining);
        };
        html.push_str(&powers_and_windows(&remaining[..plain]));
        let _ = write!(html, "<code>{code}</code>");
        remaining = after;
    }
}

fn powers_and_windows(text: &str) -> String {
    digits_in_element(&digits_in_element(text, "^", "sup"), "SEE_", "sub")
}

/// Wraps the digits after a mark in an element. A mark of letters is kept, without the character that joins it to the digits.
fn digits_in_element(text: &str, mark: &str, element: &str) -> String {
    let mut parts = text.split(mark);
    let mut html = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let digits = part.len() - part.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        let (number, remaining) = part.split_at(digits);
        if number.is_empty() {
            let _ = write!(html, "{mark}{remaining}");
        } else {
            let prefix = mark.trim_end_matches(['_', '^']);
            let _ = write!(html, "{prefix}<{element}>{number}</{element}>{remaining}");
        }
    }
    html
}

/// Returns the page up to its title.
pub(super) fn begin(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>\
         <meta name='viewport' content='width=device-width, initial-scale=1'>\
         <title>{title}</title><style>{style}{drawing}</style></head><body><h1>{title}</h1>\n",
        title = escaped(title),
        style = include_str!("page.css"),
        drawing = include_str!("drawing.css"),
    )
}

/// The end of a page.
pub(super) const END: &str = concat!(
    "\n<p class='spread'>lsdc ",
    env!("CARGO_PKG_VERSION"),
    "</p></body></html>\n"
);

/// Writes a page of charts under one legend, with a table as plain text below them.
pub(super) fn write_charts(
    path: &Path,
    title: &str,
    names: &[String],
    charts: &[Chart<'_>],
    table: &str,
) -> Result<()> {
    let page = format!(
        "{}{}<pre>{}</pre></body></html>\n",
        begin(title),
        charts_with_legend(names, charts),
        escaped(table)
    );
    write_atomically(path, |out| out.write_all(page.as_bytes()))
}

fn charts_with_legend(names: &[String], charts: &[Chart<'_>]) -> String {
    let drawn: String = charts.iter().map(|chart| chart.draw().inline()).collect();
    format!("{}<div class='charts'>{drawn}</div>", legend(names))
}

/// Returns the legend with the colours of the methods.
fn legend(methods: &[String]) -> String {
    let mut legend = String::from("<p class='legend'>");
    for (name, i) in methods.iter().zip(0..) {
        let (name, colour): (String, &str) = (escaped(name), COLOURS[i % COLOURS.len()]);
        let _ = write!(
            legend,
            "<span><i style='background:{colour}'></i>{name}</span>"
        );
    }
    legend.push_str("</p>");
    legend
}

/// Lists the frames that could not be measured.
pub(super) fn failed(failures: &[Failure]) -> String {
    if failures.is_empty() {
        return String::new();
    }
    let mut list = String::from("\n<h3>Frames that failed</h3><ul class='failures'>");
    for failure in failures {
        let text = format!("{}: {}", failure.frame, failure.error);
        let _ = write!(list, "<li>{}</li>", escaped(&text));
    }
    list + "</ul>"
}

/// Returns all metrics of each method, with separate tables of errors and shares; the best of each column is highlighted.
fn tables(means: &[Mean]) -> String {
    TABLES.iter().map(|metrics| table(means, metrics)).collect()
}

fn table(means: &[Mean], metrics: &[Metric]) -> String {
    let mut html = String::from("<div class='scroll'><table><thead><tr><th>method</th>");
    for metric in metrics {
        let (label, unit) = (markup(metric.label()), metric.unit());
        let _ = write!(html, "<th>{label} <span class='spread'>{unit}</span></th>");
    }
    html.push_str("</tr></thead><tbody>");
    for mean in means {
        let _ = write!(html, "<tr><td>{}</td>", escaped(mean.method));
        for &metric in metrics {
            let value = mean.mean[metric];
            let better = |other: &Mean| {
                let gain = value - other.mean[metric];
                if metric.is_share() {
                    gain < 0.0
                } else {
                    gain > 0.0
                }
            };
            let class = if means.len() > 1 && !means.iter().any(better) {
                " class='best'"
            } else {
                ""
            };
            let _ = write!(html, "<td{class}>{}", formatted(metric, value));
            if mean.deviation[metric].is_finite() {
                let spread = formatted(metric, mean.deviation[metric]);
                let _ = write!(html, " <span class='spread'>&plusmn;{spread}</span>");
            }
            html.push_str("</td>");
        }
        html.push_str("</tr>");
    }
    html.push_str("</tbody></table></div>");
    html
}

fn example_html(example: &ExampleFrame) -> String {
    let (low, high) = example.truth.range().unwrap_or((0.0, 1.0));
    let max_error = error_scale(example);
    let mut html = format!(
        "<h3>{}: {}</h3><p>{}{}</p><div class='figures'>",
        example.role,
        escaped(&example.frame),
        colour_scale("depth", low, high, colorous::TURBO),
        colour_scale("absolute error", 0.0, max_error, colorous::INFERNO),
    );
    let points = format!("{} points", example.sparse.count());
    html.push_str(&figure("image", &example.rgb));
    html.push_str(&figure(&points, &points_on_image(example, low, high)));
    html.push_str(&figure("truth", &coloured(&example.truth, low, high)));
    html.push_str("</div><div class='figures methods'>");
    for (method, rmse, depth) in &example.predictions {
        let method = escaped(method);
        let depth_map = coloured(depth, low, high);
        let error_map = errors(depth, &example.truth, max_error);
        html.push_str(&figure(&format!("{method}, RMSE {rmse:.3} m"), &depth_map));
        html.push_str(&figure(&format!("{method}, error"), &error_map));
    }
    html.push_str("</div>");
    html
}

fn figure(caption: &str, image: &RgbImage) -> String {
    format!(
        "<figure><img alt='{caption}' src='{}'>\
         <figcaption>{caption}</figcaption></figure>",
        data_url(image)
    )
}

/// Draws the points as dots over the darkened image.
pub(super) fn points_on_image(example: &ExampleFrame, low: f32, high: f32) -> RgbImage {
    let mut image = example.rgb.clone();
    image
        .iter_mut()
        .for_each(|value| *value = (f32::from(*value) * 0.3) as u8);
    let colours = coloured(&example.sparse, low, high);
    // Sparse points are drawn larger than one pixel where there is room for them.
    let share = example.sparse.count() as f64 / example.sparse.values().len() as f64;
    let reach = usize::from(share < 0.04);
    for point in example.sparse.points() {
        let colour = *colours.get_pixel(point.x as u32, point.y as u32);
        for y in window(point.y, reach, example.sparse.height()) {
            for x in window(point.x, reach, example.sparse.width()) {
                image.put_pixel(x as u32, y as u32, colour);
            }
        }
    }
    image
}

/// Returns the upper end of the error scale: the 98th percentile of the errors of the first method.
pub(super) fn error_scale(example: &ExampleFrame) -> f32 {
    let Some((_, _, depth)) = example.predictions.first() else {
        return 1.0;
    };
    let mut all: Vec<f32> = example
        .truth
        .values()
        .iter()
        .zip(depth.values())
        .filter(|(d, _)| **d > 0.0)
        .map(|(d, p)| (p - d).abs())
        .collect();
    all.sort_by(f32::total_cmp);
    all.get(all.len() * 98 / 100)
        .copied()
        .unwrap_or(1.0)
        .max(0.01)
}

fn colour_scale(name: &str, low: f32, high: f32, map: colorous::Gradient) -> String {
    let stops: Vec<String> = (0..=10)
        .map(|i| format!("#{:x}", map.eval_continuous(f64::from(i) / 10.0)))
        .collect();
    format!(
        "<span class='scale'>{name} {low:.2} <b style='background:linear-gradient(90deg,{})'></b> \
         {high:.2} m</span>",
        stops.join(",")
    )
}
