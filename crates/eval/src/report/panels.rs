//! Images side by side, with captions, and bars that say what their colours mean.

use super::Exhibit;
use super::colour::{coloured, errors};
use super::drawing::{Drawing, encoded, escaped};
use super::html::{dotted, scale_of_errors};
use colorous::Gradient;
use image::RgbImage;
use std::fmt::Write as _;

/// Width of a panel.
const PANEL: f64 = 216.0;
const GAP: f64 = 10.0;
/// Below a panel, for its caption.
const CAPTION: f64 = 20.0;
/// Above all, for the title, and a line of scales.
const TITLE: f64 = 28.0;
const SCALES: f64 = 30.0;

/// An image with what it shows.
#[derive(Clone, Debug)]
pub struct Panel {
    /// What it shows.
    pub caption: String,
    /// The image.
    pub image: RgbImage,
}

/// What colours mean.
#[derive(Clone, Debug)]
pub struct Scale {
    /// The quantity.
    pub name: String,
    /// The value of the first colour.
    pub low: f32,
    /// The value of the last.
    pub high: f32,
    /// Of both.
    pub unit: &'static str,
    /// The colours.
    pub map: Gradient,
}

/// Rows of panels under one set of scales.
#[derive(Clone, Debug)]
pub struct Panels {
    /// What they show.
    pub title: String,
    /// What their colours mean.
    pub scales: Vec<Scale>,
    /// From top to bottom; panels of a row have the same height.
    pub rows: Vec<Vec<Panel>>,
}

impl Panels {
    /// A frame: its image, points and truth, then every prediction above its errors, in the same
    /// colours.
    pub fn of_exhibit(exhibit: &Exhibit) -> Self {
        let (low, high) = exhibit.truth.range().unwrap_or((0.0, 1.0));
        let worst = scale_of_errors(exhibit);
        let panel = |caption: String, image: RgbImage| Panel { caption, image };
        let mut given = vec![
            panel("image".into(), exhibit.rgb.clone()),
            panel("truth".into(), coloured(&exhibit.truth, low, high)),
        ];
        if exhibit.sparse.count() > 0 {
            let points = format!("{} points", exhibit.sparse.count());
            given.insert(1, panel(points, dotted(exhibit, low, high)));
        }
        let mut rows = vec![given];
        // No more beside each other than a page is wide.
        for some in exhibit.predictions.chunks(5) {
            let depths = some.iter().map(|(name, rmse, depth)| {
                panel(
                    format!("{name}, RMSE {rmse:.3} m"),
                    coloured(depth, low, high),
                )
            });
            let wrong = some.iter().map(|(name, _, depth)| {
                panel(
                    format!("{name}, error"),
                    errors(depth, &exhibit.truth, worst),
                )
            });
            rows.push(depths.collect());
            rows.push(wrong.collect());
        }
        Self {
            title: format!("{} frame: {}", exhibit.role, exhibit.frame),
            scales: vec![
                Scale {
                    name: "depth".into(),
                    low,
                    high,
                    unit: "m",
                    map: colorous::TURBO,
                },
                Scale {
                    name: "absolute error".into(),
                    low: 0.0,
                    high: worst,
                    unit: "m",
                    map: colorous::INFERNO,
                },
            ],
            rows,
        }
    }

    /// The panels as a picture.
    pub fn draw(&self) -> Drawing {
        let most = self.rows.iter().map(Vec::len).max().unwrap_or(0).max(3);
        let mut body = format!(
            "<text class='title' x='{GAP}' y='18'>{}</text>",
            escaped(&self.title)
        );
        for (place, scale) in self.scales.iter().enumerate() {
            scale.draw(&mut body, GAP + 330.0 * place as f64, TITLE);
        }
        let mut top = TITLE + if self.scales.is_empty() { 0.0 } else { SCALES };
        for row in &self.rows {
            let mut tallest = 0.0_f64;
            for (place, Panel { caption, image }) in row.iter().enumerate() {
                let left = GAP + place as f64 * (PANEL + GAP);
                let height = PANEL * f64::from(image.height()) / f64::from(image.width().max(1));
                let _ = write!(
                    body,
                    "<image x='{left}' y='{top}' width='{PANEL}' height='{height:.1}' href='{}'/>\
                     <text x='{left}' y='{:.1}'>{}</text>",
                    encoded(image),
                    top + height + 14.0,
                    escaped(caption)
                );
                tallest = tallest.max(height);
            }
            top += tallest + CAPTION + 4.0;
        }
        Drawing {
            title: self.title.clone(),
            width: GAP + most as f64 * (PANEL + GAP),
            height: top,
            body,
        }
    }
}

impl Scale {
    /// Adds a bar of the colours, and its meaning.
    pub(super) fn draw(&self, body: &mut String, left: f64, top: f64) {
        const STEPS: u32 = 16;
        let Self {
            name,
            low,
            high,
            unit,
            map,
        } = self;
        // Equal ids on one page are of equal colours.
        let id = format!("colours-of-{}", name.replace(' ', "-"));
        let _ = write!(body, "<linearGradient id='{id}'>");
        for step in 0..=STEPS {
            let share = f64::from(step) / f64::from(STEPS);
            let colour = map.eval_continuous(share);
            let _ = write!(body, "<stop offset='{share}' stop-color='#{colour:x}'/>");
        }
        // Three digits of small values.
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
