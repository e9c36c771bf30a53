//! `lsdc node`: depth of the topics of a running robot.

mod dds;
mod parameters;

use super::args::{NodeArgs, Units};
use super::network::{open_guided_completer, with_encoder_side};
use super::{Exit, ui};
use dds::Dds;
use lsdc_core::{Completer, ViewSettings};
use lsdc_files::CloudOptions;
use lsdc_files::error::{Error, Result};
use lsdc_node::{
    Foxglove, Node, NodeConfig, NodeHandle, SystemClock, camera_info_beside, conventional_topics,
};
use lsdc_recordings::{FrameOptions, MessageType};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The weights that a deadline falls back to.
const SMALL: &str = "small";

pub(super) fn run(args: &NodeArgs) -> Result<Exit> {
    let args = &parameters::with_file(args)?;
    let config = config(args)?;
    let weights = args.model.weights.as_deref();
    let guide = args.encoder.guide.as_ref();
    let completer = open_guided_completer(weights, &args.model.device, guide)?;
    let completer = with_encoder_side(completer, args.encoder.input.side)?;
    let small = small_weights(args)?;
    let (image, points) = (
        config.topics.image.0.clone(),
        config.topics.points.0.clone(),
    );
    let mut transport = Dds::join(&config.name)?;
    let clock = Arc::new(SystemClock::default());
    let server = args
        .foxglove
        .map(|address| Foxglove::listen(address, clock.clone()))
        .transpose()?;
    let node = match &server {
        None => Node::new(config, completer, small, clock, &mut transport)?,
        Some(server) => {
            ui::tell(&format!("foxglove  ws://{}", server.address()));
            let mut shown = server.beside(&mut transport);
            Node::new(config, completer, small, clock, &mut shown)?
        }
    };
    ui::tell(&format!("node      waiting for {image} and {points}"));
    let handle = node.handle();
    ui::on_stop({
        let handle = handle.clone();
        move || handle.stop()
    });
    node.run()?;
    summarise(&handle);
    Ok(Exit::Done)
}

/// The weights for a deadline that others do not keep to.
fn small_weights(args: &NodeArgs) -> Result<Option<Completer>> {
    let is_small = args.model.weights.as_deref() == Some(Path::new(SMALL));
    if args.max_latency.is_none() || is_small {
        return Ok(None);
    }
    open_guided_completer(Some(Path::new(SMALL)), &args.model.device, None).map(Some)
}

/// Prints the counts of the run.
fn summarise(handle: &NodeHandle) {
    let status = handle.status();
    ui::tell(&format!(
        "images    {} received, {} completed, {} waiting",
        status.images,
        status.completed,
        status.waiting()
    ));
    for (kind, count) in &status.left_out {
        ui::tell(&format!("left out  {count} {kind}"));
    }
}

fn config(args: &NodeArgs) -> Result<NodeConfig> {
    let needed = |topic: &Option<String>, option: &str| {
        topic.clone().ok_or_else(|| {
            Error::config(format!("no topic is given for {option}"))
                .hint("give --image TOPIC and --points TOPIC, or --params-file FILE; `ros2 topic list -t` lists topics")
        })
    };
    let image = needed(&args.image, "--image")?;
    let points = needed(&args.points, "--points")?;
    let mut topics = conventional_topics(&image, &points);
    if let Some(kind) = args.image_type {
        topics.image.1 = kind.into();
    }
    if let Some(kind) = args.points_type {
        topics.points.1 = kind.into();
    }
    let is_cloud = topics.points.1 == MessageType::PointCloud2;
    topics.depth_info = match &args.depth_info {
        Some(_) if is_cloud => {
            return Err(
                Error::config("`--depth-info` is for images of depths").hint("leave it out")
            );
        }
        Some(info) => Some(info.clone()),
        None => (!is_cloud).then(|| camera_info_beside(&points)),
    };
    if args.camera_info.is_some() {
        topics.camera_info.clone_from(&args.camera_info);
    }
    if !args.tf.is_empty() {
        topics.tf.clone_from(&args.tf);
    }
    if args.views_count.is_some() && !args.views {
        return Err(Error::config("`--views-count` is for `--views`").hint("give both, or neither"));
    }
    let usual = NodeConfig::new(topics);
    let time = |seconds: Option<f64>, usual| seconds.map_or(usual, Duration::from_secs_f64);
    Ok(NodeConfig {
        name: args.name.clone().unwrap_or(usual.name),
        reliable: args.reliable,
        frames: FrameOptions {
            fixed: args.fixed_frame.clone(),
            tolerance: time(args.tolerance, usual.frames.tolerance),
            deskew: !args.no_deskew,
            camera: args.camera.clone(),
            unit: args.depth_unit,
            ..usual.frames
        },
        patience: time(args.wait, usual.patience),
        max_latency: args.max_latency.map(Duration::from_secs_f64),
        views: args.views.then(|| {
            let usual = ViewSettings::default();
            ViewSettings {
                count: args.views_count.map_or(usual.count, |count| count as usize),
                ..usual
            }
        }),
        depth: args.depth.clone(),
        millimetres: args.units.is_some_and(Units::is_millimetres),
        standard_deviation: args.standard_deviation,
        outliers: args.outliers,
        cloud: args.cloud.then(CloudOptions::default),
        topics: usual.topics,
    })
}
