//! Pictures as SVG documents and raster images.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::{ImageFormat, Rgb, RgbImage};
use lsdc_files::error::{Cause, Error, Result};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};
use std::io::Cursor;

/// Pixels of a raster image per drawing unit.
const PIXELS_PER_UNIT: f32 = 2.0;

/// A picture of lines, text and images.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawing {
    pub(super) title: String,
    pub(super) width: f64,
    pub(super) height: f64,
    pub(super) body: String,
}

impl Drawing {
    /// Returns SVG for a page that includes the style; empty if the drawing is empty.
    pub fn inline(&self) -> String {
        if self.body.is_empty() {
            return String::new();
        }
        format!(
            "<svg viewBox='0 0 {} {}' role='img'><title>{}</title>{}</svg>",
            self.width,
            self.height,
            escaped(&self.title),
            self.body
        )
    }

    /// Returns a standalone SVG document.
    pub fn document(&self) -> String {
        let Self {
            title,
            width,
            height,
            body,
        } = self;
        format!(
            "<svg xmlns='http://www.w3.org/2000/svg' width='{width}' height='{height}' \
             viewBox='0 0 {width} {height}'><title>{}</title><style>{}</style>\
             <rect width='100%' height='100%' fill='#fff'/>{body}</svg>\n",
            escaped(title),
            include_str!("drawing.css")
        )
    }

    /// Renders a PNG with two pixels per unit. The font is the same on every machine.
    ///
    /// # Errors
    /// The drawing has no extent.
    pub fn png(&self) -> Result<Vec<u8>> {
        let pixmap = self.pixmap(PIXELS_PER_UNIT)?;
        pixmap.encode_png().map_err(|e| self.draw_error(e))
    }

    /// Renders an image with this many pixels per unit.
    ///
    /// # Errors
    /// The drawing has no extent.
    pub(super) fn image(&self, pixels_per_unit: f32) -> Result<RgbImage> {
        let pixmap = self.pixmap(pixels_per_unit)?;
        let pixel = |x: u32, y: u32| {
            // The background is opaque.
            let found = pixmap.pixel(x, y).map(|p| [p.red(), p.green(), p.blue()]);
            Rgb(found.unwrap_or_default())
        };
        Ok(RgbImage::from_fn(pixmap.width(), pixmap.height(), pixel))
    }

    fn draw_error(&self, cause: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Error {
        Error::new(Cause::Write, format!("cannot draw `{}`", self.title)).because(cause)
    }

    fn pixmap(&self, pixels_per_unit: f32) -> Result<Pixmap> {
        let mut options = Options {
            font_family: "DejaVu Sans".to_owned(),
            ..Options::default()
        };
        let fonts = options.fontdb_mut();
        fonts.load_font_data(dejavu::sans::regular().to_vec());
        fonts.set_sans_serif_family("DejaVu Sans");
        let tree = Tree::from_str(&self.document(), &options).map_err(|e| self.draw_error(e))?;
        let size = tree.size();
        let pixels = |length: f32| (length * pixels_per_unit).ceil() as u32;
        let mut pixmap = Pixmap::new(pixels(size.width()), pixels(size.height()))
            .ok_or_else(|| self.draw_error("it has no extent"))?;
        let scale = Transform::from_scale(pixels_per_unit, pixels_per_unit);
        resvg::render(&tree, scale, &mut pixmap.as_mut());
        Ok(pixmap)
    }
}

/// Returns an image as a data URL.
pub(super) fn data_url(image: &RgbImage) -> String {
    let mut bytes = Cursor::new(Vec::new());
    // Writing to memory fails only for images without pixels.
    let written = image.write_to(&mut bytes, ImageFormat::Png);
    let bytes = written.map_or_else(|_| Vec::new(), |()| bytes.into_inner());
    format!("data:image/png;base64,{}", STANDARD.encode(bytes))
}

pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('\'', "&#39;")
        .replace('"', "&quot;")
}
