//! Selection of the topics that frames are made of.

use super::options::FrameOptions;
use crate::message::MessageType::{
    self, CameraInfo, CompressedImage, Image, PointCloud2, Transforms,
};
use crate::{Recording, Survey, Topic};
use lsdc_files::error::{Error, Result};
use std::sync::Arc;

/// The topics that frames are made of.
#[derive(Clone, Debug)]
pub struct FrameTopics {
    /// Topic of images: [`Image`](MessageType::Image) or [`CompressedImage`](MessageType::CompressedImage).
    pub image: (String, MessageType),
    /// Topic of point clouds or depth images.
    pub points: (String, MessageType),
    /// Topic of the camera of the images.
    pub camera_info: Option<String>,
    /// Topic of the camera of the depth images.
    pub depth_info: Option<String>,
    /// Topics of transforms. A topic whose name ends with `static` is valid at all times.
    pub tf: Vec<String>,
}

const IMAGES: [MessageType; 2] = [Image, CompressedImage];
const POINTS: [MessageType; 3] = [PointCloud2, Image, CompressedImage];

impl FrameTopics {
    pub(super) fn choose(recording: &mut Recording, options: &FrameOptions) -> Result<Self> {
        let mut topics = recording.topics();
        if topics.is_empty() {
            let survey = Survey::of(recording)?;
            topics = survey
                .topics
                .into_iter()
                .map(|summary| summary.topic)
                .collect();
        }
        let chooser = TopicChooser {
            topics,
            recording: recording.path().display().to_string(),
        };
        let points = chooser.pick(
            "--points",
            options.points.as_deref(),
            &POINTS,
            &[PointCloud2],
        )?;
        let image = chooser.pick("--image", options.image.as_deref(), &IMAGES, &IMAGES)?;
        let infos = [CameraInfo];
        let camera_info = match &options.camera_info {
            _ if options.camera.is_some() => None,
            Some(name) => Some(chooser.pick("--camera-info", Some(name), &infos, &[])?.0),
            None => chooser.find_camera_info(&image.0),
        };
        let depth_info = if points.1 == PointCloud2 {
            None
        } else {
            chooser.find_camera_info(&points.0)
        };
        let transforms = [Transforms];
        let tf = if options.camera.is_some() {
            Vec::new()
        } else if options.tf.is_empty() {
            chooser
                .of(&transforms)
                .map(|topic| topic.name.clone())
                .collect()
        } else {
            let picked = options
                .tf
                .iter()
                .map(|name| chooser.pick("--tf", Some(name), &transforms, &[]));
            picked.map(|found| Ok(found?.0)).collect::<Result<_>>()?
        };
        Ok(Self {
            image,
            points,
            camera_info,
            depth_info,
            tf,
        })
    }

    pub(super) fn has(&self, name: &str) -> bool {
        let one = [&self.image.0, &self.points.0].into_iter();
        let some = [&self.camera_info, &self.depth_info].into_iter().flatten();
        one.chain(some).chain(&self.tf).any(|topic| topic == name)
    }

    /// Checks that the cameras needed for points in another frame exist.
    pub(super) fn check_cameras(&self, no_camera: bool, no_depth_camera: bool) -> Result<()> {
        let missing = |what: &str, topic: &Option<String>| {
            let message = match topic {
                Some(topic) => format!("the topic `{topic}` of the camera has no messages"),
                None => format!("no topic camera_info lies beside `{what}`"),
            };
            Error::config(message).hint(
                "name it by --camera-info, or give --camera FILE with the pose of the camera in the frame of the points",
            )
        };
        if no_camera {
            return Err(missing(&self.image.0, &self.camera_info));
        }
        if self.points.1 != PointCloud2 && no_depth_camera {
            return Err(missing(&self.points.0, &self.depth_info));
        }
        Ok(())
    }
}

/// Whether the images of a topic are rectified, by the names of `image_proc`: `image_rect`, `image_rect_color`.
pub(super) fn is_rectified(topic: &str) -> bool {
    topic.split('/').any(|part| part.starts_with("image_rect"))
}

/// Topics to choose from.
struct TopicChooser {
    topics: Vec<Arc<Topic>>,
    recording: String,
}

impl TopicChooser {
    /// Returns the topics of some types.
    fn of<'a>(&'a self, types: &'a [MessageType]) -> impl Iterator<Item = &'a Arc<Topic>> {
        let is = |topic: &&Arc<Topic>| {
            MessageType::of(&topic.kind).is_some_and(|kind| types.contains(&kind))
        };
        self.topics.iter().filter(is)
    }

    /// Returns the topic that an option names, or the only topic of the default types.
    fn pick(
        &self,
        option: &str,
        named: Option<&str>,
        types: &[MessageType],
        default_types: &[MessageType],
    ) -> Result<(String, MessageType)> {
        let Self { recording, .. } = self;
        let list = |types: &[MessageType]| {
            let names: Vec<&str> = self.of(types).map(|topic| topic.name.as_str()).collect();
            if names.is_empty() {
                let types: Vec<&str> = types.iter().map(|kind| kind.name()).collect();
                let none = format!("it has none of {}", types.join(", "));
                let other = self.topics.iter().find(|topic| topic.encoding != CDR);
                match other {
                    Some(topic) => format!(
                        "{none}; `{}` is of type {}, encoded as `{}`: {ENCODED}",
                        topic.name, topic.kind, topic.encoding
                    ),
                    None => none,
                }
            } else {
                format!("these are of that type: {}", names.join(", "))
            }
        };
        let Some(named) = named else {
            // Depth images are not images to complete.
            let found = self
                .of(default_types)
                .filter(|topic| !topic.name.contains("epth"));
            let found: Vec<&Arc<Topic>> = found.collect();
            let what = match &found[..] {
                [topic] => return check_type(topic, types),
                [] => format!("`{recording}` has no topic that {option} could be"),
                _ => format!("`{recording}` has several topics that {option} could be"),
            };
            let hint = format!(
                "give {option} TOPIC; {}",
                list(if found.is_empty() {
                    types
                } else {
                    default_types
                })
            );
            return Err(Error::config(what).hint(hint));
        };
        let topic = self.topics.iter().find(|topic| topic.name == named);
        let Some(topic) = topic else {
            let what = format!("`{recording}` has no topic `{named}`");
            return Err(Error::config(what).hint(list(types)));
        };
        check_type(topic, types).map_err(|error| match error.advice() {
            Some(_) => error,
            None => error.hint(list(types)),
        })
    }

    /// Returns the camera topic of images: `camera_info` in the namespace of the images, or one level up.
    fn find_camera_info(&self, image: &str) -> Option<String> {
        let above = image.rsplit_once('/').map_or("", |(above, _)| above);
        let further = above.rsplit_once('/').map_or("", |(further, _)| further);
        let names = [above, further].map(|namespace| format!("{namespace}/camera_info"));
        let is_there = |name: &String| self.of(&[CameraInfo]).any(|topic| topic.name == *name);
        names.into_iter().find(is_there)
    }
}

/// Encoding of ROS 2 messages.
const CDR: &str = "cdr";
/// Hint for other encodings.
const ENCODED: &str = "messages of ROS 2 in cdr are read: convert recordings of ROS 1, as by rosbags-convert, and record json and protobuf \
                       (as of Foxglove) as sensor_msgs";

/// Returns the name and type of a topic, if the type is one of `types`.
fn check_type(topic: &Topic, types: &[MessageType]) -> Result<(String, MessageType)> {
    let Topic {
        name,
        kind,
        encoding,
        ..
    } = topic;
    let Some(known) = MessageType::of(kind).filter(|kind| types.contains(kind)) else {
        return Err(Error::config(format!(
            "the topic `{name}` is of type {kind}"
        )));
    };
    if encoding != CDR {
        let what = format!("the messages of `{name}` are encoded as `{encoding}`, not as {CDR}");
        return Err(Error::config(what).hint(ENCODED));
    }
    Ok((name.clone(), known))
}
