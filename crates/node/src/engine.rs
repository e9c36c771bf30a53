//! One frame: decoding, network, fit, and the messages of the result.

use crate::config::NodeConfig;
use crate::past::{Carried, PastImage, PastViews};
use crate::quality::{Level, thinned};
use lsdc_core::{
    Channels, Completer, Completion, Image, Observation, Observations, PosedView, Scene,
};
use lsdc_files::error::Result;
use lsdc_files::{Camera, ColoredCloud, MOST_TESTED};
use lsdc_recordings::{
    CameraPose, DecodedFrame, LiveFrame, Rigid, Timestamp, write_camera_info, write_cloud,
    write_depth, write_points,
};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Topics published for a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Output {
    Depth,
    CameraInfo,
    StandardDeviation,
    Outliers,
    Cloud,
}

/// Completes frames.
pub(crate) struct Engine {
    full: Completer,
    small: Option<Completer>,
    millimetres: bool,
    standard_deviation: bool,
    outliers: bool,
    cloud: Option<lsdc_files::CloudOptions>,
    past: Option<Mutex<PastViews>>,
}

/// A frame with the output of the network.
pub(crate) struct Prepared {
    frame: DecodedFrame,
    points_stamp: Timestamp,
    pose: Option<CameraPose>,
    camera_info: Option<Vec<u8>>,
    scene: Scene,
    points: Observations,
    pub(crate) level: Level,
    /// When the image was received, and when its points were available.
    pub(crate) times: FrameMoments,
}

/// When the image of a frame was received, and when its points were available.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FrameMoments {
    pub(crate) received: Duration,
    pub(crate) ready: Duration,
}

/// The messages of a completed frame, and its diagnostics.
pub(crate) struct Completed {
    pub(crate) messages: Vec<(Output, Vec<u8>)>,
    pub(crate) facts: Facts,
    pub(crate) level: Level,
    pub(crate) times: FrameMoments,
}

/// Statistics of a completed frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Facts {
    /// Points used, without those left out by reduced quality.
    pub(crate) given: usize,
    pub(crate) used: usize,
    /// Points left out by reduced quality.
    pub(crate) thinned: usize,
    /// Points whose time is unknown or not covered by transforms.
    pub(crate) unplaced: usize,
    /// Root mean square of the residuals, in metres.
    pub(crate) residual: f64,
    /// Points that disagree with the others, if that was tested.
    pub(crate) outliers: Option<usize>,
    /// What became of the points of earlier images, if they are used and the place of the camera is known.
    pub(crate) carried: Option<Carried>,
    /// Pixels beyond the range of 16-bit millimetres.
    pub(crate) beyond: usize,
    /// Pixels of sky without a point, by the guide of `anything`.
    pub(crate) sky: usize,
    /// Warnings about the frame.
    pub(crate) remarks: Vec<String>,
}

impl Engine {
    pub(crate) fn new(config: &NodeConfig, full: Completer, small: Option<Completer>) -> Self {
        Self {
            full,
            small,
            millimetres: config.millimetres,
            standard_deviation: config.standard_deviation,
            outliers: config.outliers,
            cloud: config.cloud,
            past: config.views.map(|views| Mutex::new(PastViews::new(views))),
        }
    }

    /// Whether points of earlier images are used.
    pub(crate) fn has_views(&self) -> bool {
        self.past.is_some()
    }

    pub(crate) fn has_small_weights(&self) -> bool {
        self.small.is_some()
    }

    /// Runs the network, which depends on the image alone.
    pub(crate) fn prepare(
        &self,
        frame: &LiveFrame,
        level: Level,
        times: FrameMoments,
    ) -> Result<Prepared> {
        let camera_info = frame.camera_info();
        let (points_stamp, pose) = (frame.points_stamp(), frame.pose().cloned());
        let frame = frame.decode()?;
        let small = self.small.as_ref().filter(|_| level == Level::SmallWeights);
        let completer = small.unwrap_or(&self.full);
        let (width, height) = size(&frame);
        let image = Image::new(width, height, Channels::Rgb, frame.image.as_raw())?;
        let scene = completer.scene(&image)?;
        let all = &frame.points.points;
        let fewer = thinned(all.as_slice(), level.most_points());
        let points = fewer.map_or_else(|| all.clone(), Observations::from_iter);
        Ok(Prepared {
            frame,
            points_stamp,
            pose,
            camera_info,
            scene,
            points,
            level,
            times,
        })
    }

    /// Runs the fit, and writes the messages.
    pub(crate) fn complete(&self, prepared: Prepared) -> Result<Completed> {
        let (completion, carried) = self.fit(&prepared)?;
        let Prepared {
            frame,
            camera_info,
            points,
            level,
            times,
            ..
        } = prepared;
        let depth = completion.depth()?;
        let header = &frame.header;
        let mut messages = Vec::new();
        let (message, beyond) = write_depth(header, &depth, self.millimetres);
        messages.push((Output::Depth, message));
        let given = || write_camera_info(header, frame.camera.as_ref()?, size(&frame));
        let camera_info = camera_info.or_else(given);
        messages.extend(camera_info.map(|message| (Output::CameraInfo, message)));
        let deviations = self
            .standard_deviation
            .then(|| completion.standard_deviation());
        let deviations = deviations.transpose()?;
        if let Some(deviations) = &deviations {
            let (message, _) = write_depth(header, deviations, false);
            messages.push((Output::StandardDeviation, message));
        }
        // The pose of a given camera places it among the points; depths belong to the frame of the image.
        let camera = frame.camera.as_ref().map(|camera| {
            let origin = Rigid::IDENTITY;
            camera
                .clone()
                .with_pose(origin.matrix(), origin.translation())
        });
        let mut outliers = None;
        if self.outliers
            && points.len() <= MOST_TESTED
            && let Some(camera) = &camera
        {
            let rows = outlier_rows(&completion, points.as_slice(), camera)?;
            outliers = Some(rows.len());
            let fields = ["x", "y", "z", "error", "probability"];
            messages.push((
                Output::Outliers,
                write_points(header, fields, rows.into_iter()),
            ));
        }
        if let (Some(options), Some(camera)) = (&self.cloud, &camera) {
            let cloud =
                ColoredCloud::new(&depth, deviations.as_ref(), &frame.image, camera, options);
            messages.push((Output::Cloud, write_cloud(header, &cloud.points)));
        }
        let report = completion.report();
        let facts = Facts {
            given: report.given,
            used: report.used,
            thinned: frame.points.points.len() - points.len(),
            unplaced: frame.unplaced,
            residual: report.residual,
            outliers,
            carried,
            beyond,
            sky: completion.sky_pixels(),
            remarks: frame.points.remarks,
        };
        Ok(Completed {
            messages,
            facts,
            level,
            times,
        })
    }
}

impl Engine {
    /// Fits an image to its points, and to those of earlier images if they are used and quality is not lowered.
    fn fit(&self, prepared: &Prepared) -> Result<(Completion, Option<Carried>)> {
        let Prepared {
            frame,
            scene,
            points,
            level,
            ..
        } = prepared;
        let placed = prepared.pose.as_ref().zip(frame.camera.as_ref());
        if let (Some(past), Some((pose, camera))) = (&self.past, placed) {
            let (matrix, translation) = (pose.rigid.matrix(), pose.rigid.translation());
            let camera = camera.clone().moved(matrix, translation);
            let (width, height) = size(frame);
            let own = PastImage {
                stamp: frame.header.stamp,
                points_stamp: prepared.points_stamp,
                view: PosedView::new(camera, width, height, points.clone())?,
            };
            let mut past = past.lock().unwrap_or_else(PoisonError::into_inner);
            let others = past.add(&own, pose);
            if *level == Level::Full {
                let (completion, carried) = past.complete(scene, &own.view, &others)?;
                return Ok((completion, Some(carried)));
            }
        }
        Ok((scene.complete_once(points)?, None))
    }
}

fn size(frame: &DecodedFrame) -> (usize, usize) {
    (frame.image.width() as usize, frame.image.height() as usize)
}

/// Outliers as 3D points, with their distance in metres from the depth predicted by the other points, and their probability.
fn outlier_rows(
    completion: &Completion,
    points: &[Observation],
    camera: &Camera,
) -> Result<Vec<[f32; 5]>> {
    let found = completion.outliers()?;
    let row = |outlier: &lsdc_core::Outlier| {
        let point = points.get(outlier.index)?;
        let position = camera.unproject([point.u, point.v], f64::from(point.depth))?;
        let [x, y, z] = position.map(|v| v as f32);
        Some([x, y, z, outlier.error as f32, outlier.probability as f32])
    };
    Ok(found.iter().filter_map(row).collect())
}
