//! Arguments of `node`.

use super::Model;
use super::encoder::PretrainedEncoder;
use super::recorded::{Units, seconds};
use super::values::typed;
use clap::{Args as ClapArgs, ValueEnum};
use lsdc_files::{Camera, Unit};
use lsdc_recordings::MessageType;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;

// Topics and settings of a node. What is not given is taken from the file of parameters, where the same names have
// underscores, or else its default.
#[derive(Clone, Debug, ClapArgs)]
#[command(after_long_help = "See docs/node.md for topics, types and diagnostics.")]
pub(in crate::cli) struct NodeArgs {
    /// Topic of the images.
    #[arg(long, value_name = "TOPIC", help_heading = "Input")]
    pub(in crate::cli) image: Option<String>,
    /// Topic of the points: clouds, or images of depths.
    #[arg(long, value_name = "TOPIC", help_heading = "Input")]
    pub(in crate::cli) points: Option<String>,
    /// Type of the images [default: compressed if the topic ends with `compressed`, else image].
    #[arg(
        long,
        value_name = "TYPE",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) image_type: Option<ImageType>,
    /// Type of the points [default: compressed if the topic ends with `compressedDepth`, image if its name contains `depth` or
    /// `image`, else cloud].
    #[arg(
        long,
        value_name = "TYPE",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) points_type: Option<PointsType>,
    /// Topic of the camera of the images [default: `camera_info` beside the images].
    #[arg(long, value_name = "TOPIC", help_heading = "Input")]
    pub(in crate::cli) camera_info: Option<String>,
    /// Topic of the camera of depth images [default: `camera_info` beside them].
    #[arg(
        long,
        value_name = "TOPIC",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) depth_info: Option<String>,
    /// Camera of the images where no topic describes it: a file, or FX,FY,CX,CY in pixels. It replaces the transforms, too: its
    /// pose is that of the camera in the frame of the points.
    #[arg(
        long,
        value_parser = typed::<Camera>,
        value_name = "CAMERA",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) camera: Option<Camera>,
    /// Unit of depths and coordinates: m, cm, mm, or a number of units in a metre [default: mm for integers, else m].
    #[arg(
        long,
        value_parser = typed::<Unit>,
        value_name = "UNIT",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) depth_unit: Option<Unit>,
    /// Topic of transforms; may be repeated [default: `/tf` and `/tf_static`].
    #[arg(
        long,
        value_name = "TOPIC",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) tf: Vec<String>,
    /// Have lost messages of images, points and cameras sent again. Their publishers must be reliable, too.
    #[arg(long, help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) reliable: bool,
    /// Frame in which the motion between the times of points and image is measured [default: odom, or the topmost frame].
    #[arg(
        long,
        value_name = "FRAME",
        help_heading = "Input",
        hide_short_help = true
    )]
    pub(in crate::cli) fixed_frame: Option<String>,
    /// How many seconds the points may be off an image [default: 0.05].
    #[arg(long, value_name = "SECONDS", value_parser = seconds, help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) tolerance: Option<f64>,
    /// How many seconds an image waits for points and transforms that come late [default: 0.2].
    #[arg(long, value_name = "SECONDS", value_parser = seconds, help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) wait: Option<f64>,
    /// Take all points of a cloud at its stamp.
    #[arg(long, help_heading = "Input", hide_short_help = true)]
    pub(in crate::cli) no_deskew: bool,
    /// File of parameters of ROS 2 (YAML).
    #[arg(long, value_name = "FILE", help_heading = "Input")]
    pub(in crate::cli) params_file: Option<PathBuf>,
    /// Name of the node, below which results are published [default: lsdc].
    #[arg(
        long,
        value_name = "NAME",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) name: Option<String>,
    /// Topic of the depth [default: `/NAME/depth/image`].
    #[arg(long, value_name = "TOPIC", help_heading = "Output")]
    pub(in crate::cli) depth: Option<String>,
    /// Depths in m (32FC1) or mm (16UC1) [default: m].
    #[arg(
        long,
        value_enum,
        value_name = "UNIT",
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) units: Option<Units>,
    /// Also publish standard deviations: `/NAME/standard_deviation/image`.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) standard_deviation: bool,
    /// Also publish the points that disagree with the others: `/NAME/outliers`.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) outliers: bool,
    /// Also publish the depth as a cloud: `/NAME/points`.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) cloud: bool,
    /// Join the measured points of earlier images, carried over by the transforms.
    #[arg(long, help_heading = "Output")]
    pub(in crate::cli) views: bool,
    /// With --views, the most neighbours of an image, up to 20 [default: 8].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=20), help_heading = "Output", hide_short_help = true)]
    pub(in crate::cli) views_count: Option<u32>,
    /// How many seconds may pass from the moment that image and points are there until the depth is published. Quality is lowered
    /// to keep to it: fewer points, then the weights `small` [default: any].
    #[arg(long, value_name = "SECONDS", value_parser = seconds, help_heading = "Output")]
    pub(in crate::cli) max_latency: Option<f64>,
    /// Show all topics in Foxglove: the port, or address and port, of a WebSocket. Without an address, this machine alone is served.
    #[arg(
        long,
        value_name = "[ADDR:]PORT",
        value_parser = address,
        help_heading = "Output",
        hide_short_help = true
    )]
    pub(in crate::cli) foxglove: Option<SocketAddr>,
    #[command(flatten)]
    pub(in crate::cli) model: Model,
    #[command(flatten)]
    pub(in crate::cli) encoder: PretrainedEncoder,
}

/// An address with its port, or a port of this machine.
fn address(text: &str) -> Result<SocketAddr, String> {
    let local = text
        .parse()
        .map(|port: u16| (Ipv4Addr::LOCALHOST, port).into());
    let found = local.or_else(|_| text.parse());
    found.map_err(|_| "is no port or address with a port, as in 8765 or 0.0.0.0:8765".to_owned())
}

/// Types of images.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(in crate::cli) enum ImageType {
    /// `sensor_msgs/Image`.
    Image,
    /// `sensor_msgs/CompressedImage`.
    Compressed,
}

/// Types of points.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(in crate::cli) enum PointsType {
    /// `sensor_msgs/PointCloud2`.
    Cloud,
    /// `sensor_msgs/Image` of depths.
    Image,
    /// `sensor_msgs/CompressedImage` of depths.
    Compressed,
}

impl From<ImageType> for MessageType {
    fn from(kind: ImageType) -> Self {
        match kind {
            ImageType::Image => Self::Image,
            ImageType::Compressed => Self::CompressedImage,
        }
    }
}

impl From<PointsType> for MessageType {
    fn from(kind: PointsType) -> Self {
        match kind {
            PointsType::Cloud => Self::PointCloud2,
            PointsType::Image => Self::Image,
            PointsType::Compressed => Self::CompressedImage,
        }
    }
}
