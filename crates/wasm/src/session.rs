//! The state of an instance of the module: a completer, scenes, and the outputs of the last call.

use crate::error::{Error, Kind, Result};
use crate::options::Options;
use crate::report::Report;
use lsdc_core::fit::Changes;
use lsdc_core::{
    Channels, Completer, FitError, Image, Observation, Observations, Quality, Scene, Weights,
};
use std::collections::BTreeMap;

/// Largest number of points that are tested for outliers; the test takes several fits.
const MOST_TESTED: usize = 10_000;
/// Bytes of a row of points.
const ROW: usize = 4 * size_of::<f64>();
/// Largest number of pixels of an image. An instance has at most 4 GiB of memory, and running out of it stops the instance.
const MOST_PIXELS: usize = 1 << 25;

#[derive(Default)]
pub(crate) struct Session {
    input: Vec<u8>,
    completer: Option<Completer>,
    scenes: BTreeMap<u32, Scene>,
    /// Number of the last scene that was created.
    last: u32,
    text: String,
    /// Depth, standard deviations, residuals and leave-one-out errors.
    outputs: [Vec<f32>; 4],
}

impl Session {
    /// Allocates an input of zeros, and returns its address; null if it cannot be allocated.
    pub(crate) fn reserve(&mut self, bytes: usize) -> *const u8 {
        self.input = Vec::new();
        if self.input.try_reserve_exact(bytes).is_err() {
            return std::ptr::null();
        }
        self.input.resize(bytes, 0);
        self.input.as_ptr()
    }

    /// Sets the text to an error, and clears the outputs.
    pub(crate) fn fail(&mut self, error: &Error) {
        self.text = error.json();
        self.outputs = Default::default();
    }

    pub(crate) fn text(&self) -> &str {
        &self.text
    }

    pub(crate) fn output(&self, which: usize) -> &[f32] {
        self.outputs.get(which).map_or(&[], Vec::as_slice)
    }

    pub(crate) fn free(&mut self, scene: u32) {
        self.scenes.remove(&scene);
    }

    pub(crate) fn load(&mut self) -> Result<u32> {
        let weights = Weights::from_bytes(&std::mem::take(&mut self.input))?;
        let completer = Completer::new(&weights)?;
        self.scenes.clear();
        self.completer = Some(completer);
        Ok(1)
    }

    pub(crate) fn scene(
        &mut self,
        (width, height): (usize, usize),
        channels: usize,
        best: bool,
    ) -> Result<u32> {
        let bytes = std::mem::take(&mut self.input);
        let Some(completer) = &self.completer else {
            return Err(Error::new(Kind::Use, "there is no completer yet"));
        };
        let channels = match channels {
            1 => Channels::Gray,
            3 => Channels::Rgb,
            4 => Channels::Rgba,
            other => {
                let what = format!("pixels of {other} bytes are no colours");
                return Err(Error::new(Kind::Image, what)
                    .with_hint("1, 3 or 4: grey, RGB or RGBA, of 8 bits each"));
            }
        };
        if width.saturating_mul(height) > MOST_PIXELS {
            let what = format!("{width}x{height} pixels are more than the {MOST_PIXELS} allowed");
            return Err(Error::new(Kind::Image, what)
                .with_hint("resize the image, and scale the positions of the points with it"));
        }
        let image = Image::new(width, height, channels, &bytes)?;
        let quality = if best {
            Quality::Best
        } else {
            Quality::Standard
        };
        let scene = completer.with_quality(quality).scene(&image)?;
        self.last += 1;
        self.scenes.insert(self.last, scene);
        Ok(self.last)
    }

    pub(crate) fn complete(&mut self, scene: u32, count: usize) -> Result<u32> {
        let input = std::mem::take(&mut self.input);
        self.outputs = Default::default();
        let (Some(completer), Some(scene)) = (&self.completer, self.scenes.get(&scene)) else {
            return Err(Error::new(Kind::Use, "the scene was freed before"));
        };
        let rows = count.checked_mul(ROW).filter(|&end| end <= input.len());
        let Some(end) = rows else {
            return Err(Error::new(Kind::Use, "the input ends before its points"));
        };
        let (rows, json) = input.split_at(end);
        let options = Options::parse(json)?;
        let points = options.with_deviations(points(rows))?;
        let changes = options.changes();
        let scene = if changes == Changes::default() {
            scene.clone()
        } else {
            scene.with_fit(completer.fit_config().changed(&changes))?
        };
        let completion = scene.complete(&points)?;
        let depth = completion.depth()?;
        let mut remarks = Vec::new();
        let mut deviations = Vec::new();
        if options.deviations {
            match completion.standard_deviation() {
                Ok(map) => deviations = map.into_values(),
                Err(lsdc_core::Error::Fit(why @ FitError::TooFewPoints(_))) => {
                    remarks.push(format!("there are no standard deviations: {why}"));
                }
                Err(error) => return Err(error.into()),
            }
        }
        let few = completion.report().used <= MOST_TESTED;
        let tested = (options.outliers && few).then(|| completion.outliers());
        let outliers = tested.transpose()?;
        if options.outliers && !few {
            remarks.push(format!(
                "more than {MOST_TESTED} points are not tested for outliers"
            ));
        }
        let single = |values: Vec<f64>| values.into_iter().map(|value| value as f32).collect();
        let has_deviations = !deviations.is_empty();
        let mut report = Report::new(&completion, &depth, outliers.as_deref(), has_deviations);
        report.remarks = remarks;
        self.text = report.json();
        self.outputs = [
            depth.into_values(),
            deviations,
            single(completion.residuals()),
            outliers.map_or_else(Vec::new, |_| single(completion.leave_one_out())),
        ];
        Ok(1)
    }
}

/// Reads points from rows of column, row, depth and standard deviation.
fn points(rows: &[u8]) -> Observations {
    let rows = rows.as_chunks::<ROW>().0.iter();
    let point = |row: &[u8; ROW]| {
        let (numbers, _) = row.as_chunks();
        let [u, v, depth, sigma] = std::array::from_fn(|i| f64::from_le_bytes(numbers[i]));
        Observation {
            u,
            v,
            depth: depth as f32,
            sigma: (!sigma.is_nan()).then_some(sigma as f32),
        }
    };
    rows.map(point).collect()
}
