//! Teacher predictions for training frames: depth at pixels without measurements.

use super::relative_depth::{RelativeDepths, relative_depths};
use crate::predict::completer;
use crate::sample::F16Cache;
use burn::tensor::Device;
use image::RgbImage;
use lsdc_core::Completer;
use lsdc_eval::data::{Dataset, DepthMap, Frame, FrameId, Target};
use lsdc_eval::fit_settings::FitSettings;
use lsdc_eval::predict::{DEPTH_ANYTHING, GuideSpec, MonocularGuide, complete};
use lsdc_eval::sampling::{Interpolation, Pattern, Protocol, Size, resize_depth};
use lsdc_files::error::{Error, Result};
use lsdc_rng::{Rng, hash};
use lsdc_weights::ANYTHING;
use lsdc_weights::history::SourceWeights;
use lsdc_weights::{open_weights, weights_hash};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;

/// Training targets provided by a teacher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DistillTarget {
    /// Measured depths, and the teacher's at other pixels.
    #[default]
    Fill,
    /// The teacher's depths at all pixels.
    All,
    /// The teacher's depths for images without depths; other frames keep their holes.
    Images,
    /// Measured depths alone: the teacher is not run for depths; only its network is compared with.
    Measured,
}

/// Settings of a teacher, a network that completes training frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TeacherConfig {
    /// Weights of the teacher: a file, or a built-in name. `depth-anything` or `depth-anything:SIDE` is Depth Anything V2
    /// Small, which predicts relative depths for images without depths.
    pub weights: PathBuf,
    /// Settings that override the fit of its weights.
    pub fit: FitSettings,
    /// Number of measured depths of a frame given to the teacher, drawn at random; all if absent.
    pub points: Option<usize>,
    /// Training target.
    pub target: DistillTarget,
    /// Ratio of its standard deviation to its depth at which an error counts half: with r times this ratio, the weight is 1 /
    /// (1 + r^2). Errors at measured depths have a weight of 1.
    pub tolerance: f32,
    /// Folder of cached predictions, shared by any number of runs: 4 bytes per pixel of a scaled frame. If absent, they are
    /// computed in every run.
    pub folder: Option<PathBuf>,
}

impl Default for TeacherConfig {
    fn default() -> Self {
        Self {
            weights: "anything".into(),
            fit: FitSettings::default(),
            points: None,
            target: DistillTarget::Fill,
            tolerance: 0.1,
            folder: None,
        }
    }
}

impl TeacherConfig {
    pub(crate) fn check(&self) -> Result<()> {
        if self.points == Some(0) {
            return Err(Error::config("`train.teacher.points` must be above 0")
                .hint("leave it out to give the teacher all depths"));
        }
        if !(self.tolerance > 0.0 && self.tolerance.is_finite()) {
            return Err(Error::config("`train.teacher.tolerance` must be above 0"));
        }
        let of_points = self.target != DistillTarget::Images
            || self.points.is_some()
            || self.fit != FitSettings::default();
        if of_points && self.guide()?.is_some() {
            let what = "the teacher `depth-anything` sees images alone";
            return Err(Error::config(what).hint(
                "set `train.teacher.target` to \"images\", and leave out `points` and `fit`",
            ));
        }
        Ok(())
    }

    /// Returns the teacher as a source of trained weights, for their record.
    ///
    /// # Errors
    /// The teacher cannot be read.
    pub(crate) fn source(&self) -> Result<SourceWeights> {
        let role = "teacher";
        let Some(network) = self.monocular()? else {
            return SourceWeights::open(role, &self.weights);
        };
        Ok(SourceWeights {
            role: role.to_owned(),
            weights: self.weights.display().to_string(),
            contents: network.hash().to_owned(),
            history: Vec::new(),
        })
    }

    /// Returns Depth Anything as a guide, if it is the teacher.
    fn guide(&self) -> Result<Option<GuideSpec>> {
        let name = self.weights.to_str();
        let name = name.filter(|name| name.starts_with(DEPTH_ANYTHING));
        let guide = name.map(GuideSpec::from_str).transpose()?;
        Ok(guide.filter(|guide| matches!(guide, GuideSpec::DepthAnything(_))))
    }

    /// Loads Depth Anything from the user's data folder, if it is the teacher.
    fn monocular(&self) -> Result<Option<MonocularGuide>> {
        MonocularGuide::open(self.guide()?.as_ref())
    }

    /// Returns the inputs of its predictions apart from the frames: weights, fit, and numerics of the program. Predictions are
    /// rounded to half precision, so machines with other instruction sets share them.
    ///
    /// # Errors
    /// The weights cannot be read, or the fit is out of range.
    pub fn identity(&self) -> Result<Value> {
        if let Some(network) = self.monocular()? {
            return Ok(json!([lsdc_weights::golden(), network.made_from()]));
        }
        let weights = open_weights(Some(&self.weights))?;
        let fit = self.fit.over(&weights.fit()?.unwrap_or_default())?;
        let encoder = weights.network.extractor.encoder > 0;
        Ok(json!({
            "numerics": lsdc_weights::golden(),
            "weights": weights_hash(Some(&self.weights))?,
            "encoder": encoder.then_some(ANYTHING.identity),
            "fit": fit,
        }))
    }
}

/// The network that predicts depths.
enum TeacherNetwork {
    /// A completer, from points.
    Completer(Box<Completer>),
    /// Depth Anything, from photographs alone.
    Monocular(MonocularGuide),
}

/// A dataset with frames scaled by a protocol and completed by a teacher: each frame that the teacher completes has a depth at
/// every pixel, the measured one if there is one, and a target.
pub(crate) struct DistilledDataset {
    frames: Arc<dyn Dataset>,
    protocol: Protocol,
    teacher: Teacher,
}

impl DistilledDataset {
    /// Wraps a dataset; the teacher completes its frames when they are loaded.
    ///
    /// # Errors
    /// The weights cannot be read or used.
    pub(crate) fn new(
        frames: Arc<dyn Dataset>,
        protocol: Protocol,
        config: &TeacherConfig,
    ) -> Result<Self> {
        Ok(Self {
            frames,
            protocol,
            teacher: Teacher::new(config)?,
        })
    }
}

impl Dataset for DistilledDataset {
    fn description(&self) -> String {
        let weights = self.teacher.config.weights.display();
        format!("{}, completed by `{weights}`", self.frames.description())
    }

    fn len(&self) -> usize {
        self.frames.len()
    }

    fn id(&self, index: usize) -> FrameId {
        self.frames.id(index)
    }

    fn files(&self, index: usize) -> Vec<PathBuf> {
        self.frames.files(index)
    }

    fn load(&self, index: usize) -> Result<Frame> {
        let frame = self.frames.load(index)?;
        let scaled = self.protocol.scale(&frame)?;
        let uncut = Protocol {
            cut: self.protocol.cut,
            ..Protocol::default()
        };
        self.teacher.distilled(scaled, &uncut.scale(&frame)?.rgb)
    }
}

struct Teacher {
    network: TeacherNetwork,
    config: TeacherConfig,
    /// Key that changes with the teacher.
    identity: String,
    cache: F16Cache,
}

impl Teacher {
    fn new(config: &TeacherConfig) -> Result<Self> {
        let network = if let Some(network) = config.monocular()? {
            TeacherNetwork::Monocular(network)
        } else {
            // Runs on the CPU, in the threads that load frames, independent of the training device.
            let weights = open_weights(Some(&config.weights))?;
            let completer = completer(&weights, &Device::flex())?;
            let fit = config.fit.over(completer.fit_config())?;
            TeacherNetwork::Completer(Box::new(completer.with_fit(fit)))
        };
        Ok(Self {
            network,
            identity: config.identity()?.to_string(),
            cache: F16Cache::new(config.folder.clone()),
            config: config.clone(),
        })
    }

    /// Adds depths at all pixels and a target to a scaled frame, if the training target needs predictions for it. `photograph`
    /// is the image before scaling.
    fn distilled(&self, mut frame: Frame, photograph: &RgbImage) -> Result<Frame> {
        let (width, height) = (frame.depth.width(), frame.depth.height());
        let count = frame.depth.count();
        let fill = self.config.target != DistillTarget::All;
        let predicts = match self.config.target {
            DistillTarget::All => true,
            DistillTarget::Fill => count < width * height,
            DistillTarget::Images => count == 0,
            DistillTarget::Measured => false,
        };
        if !predicts {
            return Ok(frame);
        }
        let (depths, deviations) = match &self.network {
            TeacherNetwork::Completer(completer) => self.completed(completer, &frame)?,
            TeacherNetwork::Monocular(network) => {
                self.monocular(network, &frame.id, photograph, Size::of(&frame.depth))?
            }
        };
        let measured = frame.depth.values();
        let pairs = measured.iter().zip(&depths);
        let filled: Vec<f32> = pairs.map(|(&m, &d)| if m > 0.0 { m } else { d }).collect();
        let weights = (0..width * height).map(|i| {
            if fill && measured[i] > 0.0 {
                return 1.0;
            }
            let ratio = deviations[i] / (self.config.tolerance * depths[i]);
            // Not finite at pixels without depth.
            if ratio.is_finite() {
                1.0 / (1.0 + ratio * ratio)
            } else {
                0.0
            }
        });
        let weights = weights.collect();
        let map = |values| DepthMap::new(width, height, values);
        let depth = map(filled)?;
        frame.target = Some(Target {
            depth: if fill { depth.clone() } else { map(depths)? },
            weights,
        });
        frame.depth = depth;
        Ok(frame)
    }

    /// Returns depths and their standard deviations in metres, row by row, completed from the frame's points.
    fn completed(&self, completer: &Completer, frame: &Frame) -> Result<(Vec<f32>, Vec<f32>)> {
        let points = match self.config.points {
            // The same points in every run.
            Some(count) => Pattern::Exactly(count).draw(frame, 0)?,
            None => frame.depth.clone(),
        };
        let pixels = points.values().len();
        let key = self.key(frame, &points);
        let mut depths = self
            .cache
            .get(key, 2 * pixels, || compute(completer, frame, &points))?;
        let deviations = depths.split_off(pixels);
        Ok((depths, deviations))
    }

    /// Returns depths with a mean of 1 and their standard deviations, from a photograph alone. The inverse depth is cached.
    fn monocular(
        &self,
        network: &MonocularGuide,
        id: &FrameId,
        photograph: &RgbImage,
        size: Size,
    ) -> Result<(Vec<f32>, Vec<f32>)> {
        let key = hash(&[
            self.identity.as_bytes(),
            &size.width.to_le_bytes(),
            &photograph.width().to_le_bytes(),
            photograph.as_raw(),
        ]);
        let pixels = size.width * size.height;
        let inverse = self.cache.get(key, pixels, || {
            let map = network
                .inverse_depth(photograph)
                .map_err(|e| located(id, e))?;
            let map = resize_depth(&map, size, Interpolation::PilBilinear)?;
            Ok(map.values().to_vec())
        })?;
        let mut rng = Rng::stream(key, &["shift"]);
        let RelativeDepths {
            mut depths,
            mut deviations,
        } = relative_depths(&inverse, &mut rng);
        let known = depths.iter().filter(|depth| **depth > 0.0);
        let (count, sum) = known.fold((0, 0.0), |(n, sum), &d| (n + 1, sum + f64::from(d)));
        // Positive, even if the whole image is sky.
        let mean = ((sum / f64::from(count.max(1))) as f32).max(f32::MIN_POSITIVE);
        let values = depths.iter_mut().chain(&mut deviations);
        values.for_each(|value| *value /= mean);
        Ok((depths, deviations))
    }

    /// Returns a key that depends on everything that a prediction depends on.
    fn key(&self, frame: &Frame, points: &DepthMap) -> u64 {
        let depths = points.values().iter().flat_map(|d| d.to_le_bytes());
        let depths: Vec<u8> = depths.collect();
        hash(&[
            self.identity.as_bytes(),
            &frame.rgb.width().to_le_bytes(),
            frame.rgb.as_raw(),
            &depths,
        ])
    }
}

/// Returns depths, then standard deviations. An image without depths is completed from a single point in its centre and scaled
/// to a mean depth of 1: results do not depend on scale.
fn compute(completer: &Completer, frame: &Frame, points: &DepthMap) -> Result<Vec<f32>> {
    let (width, height) = (points.width(), points.height());
    let without_points = points.count() == 0;
    let observed = if without_points {
        let mut values = vec![0.0; width * height];
        values[height / 2 * width + width / 2] = 1.0;
        &DepthMap::new(width, height, values)?
    } else {
        points
    };
    let located = |e| located(&frame.id, e);
    let found = complete(completer, &frame.rgb, observed).map_err(located)?;
    let deviation = found.standard_deviation().map_err(|e| located(e.into()))?;
    let depth = found.depth()?;
    let mut values = [depth.values(), deviation.values()].concat();
    if without_points {
        let sum: f64 = depth.values().iter().map(|&d| f64::from(d)).sum();
        let mean = (sum / (width * height) as f64) as f32;
        for value in &mut values {
            *value /= mean;
        }
    }
    Ok(values)
}

/// Returns the error of the teacher with the name of the frame.
fn located(id: &FrameId, e: Error) -> Error {
    let what = format!("the teacher cannot complete frame `{id}`");
    Error::new(e.cause(), what).because(e)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;
    use lsdc_eval::data::{Rooms, RoomsConfig, Split};

    fn config() -> TeacherConfig {
        TeacherConfig {
            weights: "small".into(),
            ..TeacherConfig::default()
        }
    }

    fn room() -> Frame {
        let rooms = RoomsConfig {
            width: 48,
            height: 36,
            ..RoomsConfig::default()
        };
        let rooms = Rooms::new(Split::Train, &rooms).unwrap();
        rooms.load(0).unwrap()
    }

    fn map(of: &Frame, depth: impl Fn(usize, f32) -> f32) -> DepthMap {
        let values = of.depth.values().iter().enumerate();
        let values = values.map(|(i, &d)| depth(i, d)).collect();
        DepthMap::new(of.depth.width(), of.depth.height(), values).unwrap()
    }

    /// Returns a room without depth at every second pixel.
    fn holed() -> Frame {
        let whole = room();
        Frame {
            depth: map(&whole, |i, d| if i % 2 == 0 { 0.0 } else { d }),
            ..whole
        }
    }

    fn taught(config: &TeacherConfig, frame: Frame) -> Frame {
        let photograph = frame.rgb.clone();
        let teacher = Teacher::new(config).unwrap();
        teacher.distilled(frame, &photograph).unwrap()
    }

    /// Returns whether values agree within the 11 bits of half precision.
    fn close(a: f32, b: f32) -> bool {
        (a - b).abs() <= b.abs() / 1024.0
    }

    #[test]
    fn holes_are_filled_and_count_by_the_standard_deviation() {
        let frame = holed();
        let found = taught(&config(), frame.clone());
        let weights = open_weights(Some("small".as_ref())).unwrap();
        let completer = completer(&weights, &Device::flex()).unwrap();
        let completion = complete(&completer, &frame.rgb, &frame.depth).unwrap();
        let (depth, deviation) = (
            completion.depth().unwrap(),
            completion.standard_deviation().unwrap(),
        );
        let target = found.target.unwrap();
        assert_eq!(target.depth, found.depth);
        for (i, &measured) in frame.depth.values().iter().enumerate() {
            let (value, weight) = (found.depth.values()[i], target.weights[i]);
            if measured > 0.0 {
                assert_eq!((value, weight), (measured, 1.0));
            } else {
                let ratio = deviation.values()[i] / depth.values()[i] / 0.1;
                assert!(close(value, depth.values()[i]));
                assert!((weight - 1.0 / (1.0 + ratio * ratio)).abs() < 1e-3);
            }
        }

        let all = TeacherConfig {
            target: DistillTarget::All,
            points: Some(20),
            tolerance: 0.2,
            ..config()
        };
        let found = taught(&all, frame.clone());
        let points = Pattern::Exactly(20).draw(&frame, 0).unwrap();
        let depth = complete(&completer, &frame.rgb, &points).unwrap();
        let depth = depth.depth().unwrap();
        let target = found.target.unwrap();
        let pairs = target.depth.values().iter().zip(depth.values());
        assert!(pairs.clone().all(|(a, b)| close(*a, *b)));
        assert!(target.weights.iter().all(|w| *w > 0.0 && *w < 1.0));
        // Points are still drawn from the measured depths.
        assert_eq!(found.depth.values()[1], frame.depth.values()[1]);
        assert!(close(found.depth.values()[0], depth.values()[0]));

        let whole = room();
        let found = taught(&config(), whole.clone());
        assert_eq!((found.depth, found.target), (whole.depth, None));

        let images = TeacherConfig {
            target: DistillTarget::Images,
            ..config()
        };
        let found = taught(&images, frame.clone());
        assert_eq!((found.depth, found.target), (frame.depth, None));
    }

    #[test]
    fn an_image_without_depths_has_a_mean_depth_of_one() {
        let whole = room();
        let frame = Frame {
            depth: map(&whole, |_, _| 0.0),
            ..whole
        };
        let images = TeacherConfig {
            target: DistillTarget::Images,
            ..config()
        };
        let found = taught(&images, frame.clone());
        let filled = taught(&config(), frame);
        assert_eq!(
            (&found.depth, &found.target),
            (&filled.depth, &filled.target)
        );
        let depths = found.depth.values();
        assert_eq!(found.depth.count(), depths.len());
        let mean = depths.iter().sum::<f32>() / depths.len() as f32;
        assert!((mean - 1.0).abs() < 1e-3, "{mean}");
        let weights = found.target.unwrap().weights;
        assert!(weights.iter().all(|w| *w > 0.0 && *w < 1.0));
    }

    #[test]
    fn answers_are_kept_until_something_changes_that_they_depend_on() {
        let folder = tempfile::tempdir().unwrap();
        let kept = TeacherConfig {
            folder: Some(folder.path().into()),
            ..config()
        };
        let files = || std::fs::read_dir(folder.path()).unwrap().count();
        let first = taught(&kept, holed());
        assert_eq!(files(), 1);
        // The key does not depend on the name of the frame or on the use of the prediction.
        let renamed = Frame {
            id: "other".into(),
            ..holed()
        };
        let used = TeacherConfig {
            target: DistillTarget::All,
            tolerance: 0.5,
            ..kept.clone()
        };
        assert_eq!(taught(&kept, renamed.clone()).depth, first.depth);
        taught(&used, renamed);
        assert_eq!(files(), 1);

        let mut coloured = holed();
        coloured.rgb.put_pixel(3, 3, Rgb([1, 2, 3]));
        let mut moved = holed();
        moved.depth = map(&moved, |i, d| if i == 5 { 2.0 * d } else { d });
        let fit = toml::from_str("method = \"lse\"").unwrap();
        let lse = TeacherConfig {
            fit,
            ..kept.clone()
        };
        let other = TeacherConfig {
            weights: "default".into(),
            ..kept.clone()
        };
        let fewer = TeacherConfig {
            points: Some(30),
            ..kept.clone()
        };
        let changes = [
            (&kept, coloured),
            (&kept, moved),
            (&lse, holed()),
            (&other, holed()),
            (&fewer, holed()),
        ];
        for (count, (config, frame)) in changes.into_iter().enumerate() {
            assert_ne!(taught(config, frame).depth, first.depth, "{count}");
            assert_eq!(files(), count + 2);
        }
        // Read from the cache.
        assert_eq!(taught(&kept, holed()).target, first.target);
        assert_eq!(files(), 6);
    }
}
