//! Images side by side, with captions and colour scales.

use super::ExampleFrame;
use super::colour::{coloured, errors};
use super::drawing::{Drawing, data_url, escaped};
use super::html::{error_scale, points_on_image};
use colorous::Gradient;
use image::RgbImage;
use std::fmt::Write as _;

/// Width of a panel.
const PANEL: f64 = 216.0;
const GAP: f64 = 10.0;
/// Height below a panel for its caption.
const CAPTION: f64 = 20.0;
/// Heights above all panels: the title, and a line of scales.
const TITLE: f64 = 28.0;
const SCALES: f64 = 30.0;

/// An image with its caption.
#[derive(Clone, Debug)]
pub struct Panel {
    /// The caption.
    pub caption: String,
    /// The image.
    pub image: RgbImage,
}

/// A colour scale.
#[derive(Clone, Debug)]
pub struct ColourScale {
    /// Name of the quantity.
    pub name: String,
    /// Value of the first colour.
    pub low: f32,
    /// Value of the last colour.
    pub high: f32,
    /// Unit of both values.
    pub unit: &'static str,
    /// The colour map.
    pub map: Gradient,
}

/// Rows of panels under one set of scales.
#[derive(Clone, Debug)]
pub struct Panels {
    /// Title above all panels.
    pub title: String,
    /// Colour scales of the panels.
    pub scales: Vec<ColourScale>,
    /// Rows from top to bottom; panels of a row have the same height.
    pub rows: Vec<Vec<Panel>>,
}

impl Panels {
    /// Returns the panels of a frame: its image, points and truth, then every prediction above its errors, in the same colours.
    pub fn of_example(example: &ExampleFrame) -> Self {
        let (low, high) = example.truth.range().unwrap_or((0.0, 1.0));
        let max_error = error_scale(example);
        let panel = |caption: String, image: RgbImage| Panel { caption, image };
        let mut inputs = vec![
            panel("image".into(), example.rgb.clone()),
            panel("truth".into(), coloured(&example.truth, low, high)),
        ];
        if example.sparse.count() > 0 {
            let points = format!("{} points", example.sparse.count());
            inputs.insert(1, panel(points, points_on_image(example, low, high)));
        }
        let mut rows = vec![inputs];
        // Limit of panels that fit beside each other on a page.
        for chunk in example.predictions.chunks(5) {
            let depths = chunk.iter().map(|(name, rmse, depth)| {
                panel(
                    format!("{name}, RMSE {rmse:.3} m"),
                    coloured(depth, low, high),
                )
            });
            let error_maps = chunk.iter().map(|(name, _, depth)| {
                panel(
                    format!("{name}, error"),
                    errors(depth, &example.truth, max_error),
                )
            });
            rows.push(depths.collect());
            rows.push(error_maps.collect());
        }
        Self {
            title: format!("{} frame: {}", example.role, example.frame),
            scales: vec![
                ColourScale {
                    name: "depth".into(),
                    low,
                    high,
                    unit: "m",
                    map: colorous::TURBO,
                },
                ColourScale {
                    name: "absolute error".into(),
                    low: 0.0,
                    high: max_error,
                    unit: "m",
                    map: colorous::INFERNO,
                },
            ],
            rows,
        }
    }

    /// Draws the panels.
    pub fn draw(&self) -> Drawing {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0).max(3);
        let mut body = format!(
            "<text class='title' x='{GAP}' y='18'>{}</text>",
            escaped(&self.title)
        );
        for (index, scale) in self.scales.iter().enumerate() {
            scale.draw(&mut body, GAP + 330.0 * index as f64, TITLE);
        }
        let mut top = TITLE + if self.scales.is_empty() { 0.0 } else { SCALES };
        for row in &self.rows {
            let mut tallest = 0.0_f64;
            for (index, Panel { caption, image }) in row.iter().enumerate() {
                let left = GAP + index as f64 * (PANEL + GAP);
                let height = PANEL * f64::from(image.height()) / f64::from(image.width().max(1));
                let _ = write!(
                    body,
                    "<image x='{left}' y='{top}' width='{PANEL}' height='{height:.1}' href='{}'/>\
                     <text x='{left}' y='{:.1}'>{}</text>",
                    data_url(image),
                    top + height + 14.0,
                    escaped(caption)
                );
                tallest = tallest.max(height);
            }
            top += tallest + CAPTION + 4.0;
        }
        Drawing {
            title: self.title.clone(),
            width: GAP + columns as f64 * (PANEL + GAP),
            height: top,
            body,
        }
    }
}

impl ColourScale {
    /// Adds a colour bar with its labels.
    pub(super) fn draw(&self, body: &mut String, left: f64, top: f64) {
        const STEPS: u32 = 16;
        let Self {
            name,
            low,
            high,
            unit,
            map,
        } = self;
        // Equal ids on one page have equal colours.
        let id = format!("colours-of-{}", name.replace(' ', "-"));
        let _ = write!(body, "<linearGradient id='{id}'>");
        for step in 0..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            let colour = map.eval_continuous(share);
            let _ = write!(body, "<stop offset='{share}' stop-color='#{colour:x}'/>");
        }
        // Small values are shown with three digits.
        let digits = (2.0 - high.abs().log10().floor()).clamp(2.0, 6.0) as usize;
        let _ = write!(
            body,
            "</linearGradient><rect x='{left}' y='{top}' width='120' height='12' \
             fill='url(#{id})'/><text x='{}' y='{}'>{} {low:.digits$} to {high:.digits$} {unit}</text>",
            left + 128.0,
            top + 11.0,
            escaped(name)
        );
    }
}
