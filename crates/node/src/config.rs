//! Topics and settings of the node.

use lsdc_core::ViewSettings;
use lsdc_files::CloudOptions;
use lsdc_recordings::{FrameOptions, FrameTopics, MessageType};
use std::time::Duration;

/// Topics and settings of a node.
#[derive(Clone, Debug)]
pub struct NodeConfig {
    /// Name of the node, without a slash; results are published below it.
    pub name: String,
    /// Topics to subscribe to.
    pub topics: FrameTopics,
    /// Whether lost messages of images, points and cameras are requested again, which best-effort publishers do not serve: a
    /// reliable subscription does not match them.
    pub reliable: bool,
    /// How points are matched to images. Its topic names are ignored.
    pub frames: FrameOptions,
    /// How long an image waits for points and transforms after it was received.
    pub patience: Duration,
    /// Allowed time from the moment when image and points are both available until the depth is published. Quality is
    /// reduced to meet it.
    pub max_latency: Option<Duration>,
    /// Whether the measured points of earlier images join those of each image, carried over by the transforms: those of so many
    /// neighbours, whatever `only_past` says. Not while quality is lowered.
    pub views: Option<ViewSettings>,
    /// Topic of the depth [default: `~/depth/image`].
    pub depth: Option<String>,
    /// Publish depth in whole millimetres (16UC1) instead of metres (32FC1).
    pub millimetres: bool,
    /// Publish standard deviations as `~/standard_deviation/image`.
    pub standard_deviation: bool,
    /// Publish points that disagree with the others as `~/outliers`.
    pub outliers: bool,
    /// Also publish the depth as a cloud, `~/points`.
    pub cloud: Option<CloudOptions>,
}

impl NodeConfig {
    /// Default settings for these topics.
    pub fn new(topics: FrameTopics) -> Self {
        Self {
            name: "lsdc".to_owned(),
            topics,
            reliable: false,
            frames: FrameOptions::default(),
            // Two turns of a scanner at 10 Hz, which publishes its cloud at the end of a turn.
            patience: Duration::from_millis(200),
            max_latency: None,
            views: None,
            depth: None,
            millimetres: false,
            standard_deviation: false,
            outliers: false,
            cloud: None,
        }
    }
}

/// Topics for images and points, by the conventions of ROS.
///
/// Message types are inferred from names: topics of compressed images end in `/compressed` or `/compressedDepth`, those of
/// depth images contain `depth` or `image`. The camera is `camera_info` beside the images; transforms are `/tf` and
/// `/tf_static`.
///
/// ```
/// use lsdc_node::conventional_topics;
/// use lsdc_recordings::MessageType;
///
/// let topics = conventional_topics("/camera/image_raw/compressed", "/lidar/points");
/// assert_eq!(topics.image.1, MessageType::CompressedImage);
/// assert_eq!(topics.points.1, MessageType::PointCloud2);
/// assert_eq!(topics.camera_info.as_deref(), Some("/camera/camera_info"));
/// ```
pub fn conventional_topics(image: &str, points: &str) -> FrameTopics {
    let kind = |topic: &str, usual| {
        if transported(topic) == topic {
            usual
        } else {
            MessageType::CompressedImage
        }
    };
    let is_depth = ["depth", "image"].iter().any(|part| {
        let points = transported(points).rsplit('/').take(2);
        points.into_iter().any(|name| name.contains(part))
    }) && !points.ends_with("/points");
    let usual_points = if is_depth {
        MessageType::Image
    } else {
        MessageType::PointCloud2
    };
    let points_kind = kind(points, usual_points);
    FrameTopics {
        image: (image.to_owned(), kind(image, MessageType::Image)),
        points: (points.to_owned(), points_kind),
        camera_info: Some(camera_info_beside(image)),
        depth_info: (points_kind != MessageType::PointCloud2).then(|| camera_info_beside(points)),
        tf: vec!["/tf".to_owned(), "/tf_static".to_owned()],
    }
}

/// Topic of the camera info of images: `camera_info` in the same namespace, as in `image_transport`.
pub fn camera_info_beside(image: &str) -> String {
    let above = transported(image).rsplit_once('/');
    format!("{}/camera_info", above.map_or("", |(above, _)| above))
}

/// The base topic of an image transport.
fn transported(topic: &str) -> &str {
    let ends = ["/compressed", "/compressedDepth"];
    let found = ends.iter().find_map(|end| topic.strip_suffix(end));
    found.unwrap_or(topic)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsdc_recordings::MessageType::{CompressedImage, Image, PointCloud2};

    #[test]
    fn types_follow_from_names() {
        for (points, kind, info) in [
            ("/lidar/points", PointCloud2, None),
            ("/velodyne_points", PointCloud2, None),
            ("/camera/depth/points", PointCloud2, None),
            (
                "/camera/depth/image_rect_raw",
                Image,
                Some("/camera/depth/camera_info"),
            ),
            ("/depth_registered", Image, Some("/camera_info")),
            (
                "/camera/depth/image_raw/compressedDepth",
                CompressedImage,
                Some("/camera/depth/camera_info"),
            ),
        ] {
            let topics = conventional_topics("/camera/color/image_raw", points);
            assert_eq!(topics.points.1, kind, "{points}");
            assert_eq!(topics.depth_info.as_deref(), info);
            assert_eq!(
                topics.camera_info.as_deref(),
                Some("/camera/color/camera_info")
            );
        }
    }
}
