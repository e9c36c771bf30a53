//! Which topics hold what.

use super::wanted::Wanted;
use crate::message::Kind;
use crate::{Recording, Survey, Topic};
use lsdc_files::error::{Error, Result};
use std::sync::Arc;

/// The topics that frames are made of.
#[derive(Clone, Debug)]
pub(super) struct Topics {
    pub(super) image: (String, Kind),
    pub(super) points: (String, Kind),
    pub(super) camera_info: Option<String>,
    /// Of images of depths.
    pub(super) depth_info: Option<String>,
    pub(super) tf: Vec<String>,
}

const IMAGES: [Kind; 2] = [Kind::Image, Kind::CompressedImage];
const POINTS: [Kind; 3] = [Kind::PointCloud2, Kind::Image, Kind::CompressedImage];

impl Topics {
    pub(super) fn choose(recording: &mut Recording, wanted: &Wanted) -> Result<Self> {
        let mut topics = recording.topics();
        if topics.is_empty() {
            let survey = Survey::of(recording)?;
            topics = survey
                .topics
                .into_iter()
                .map(|counted| counted.topic)
                .collect();
        }
        let choice = Choice {
            topics,
            recording: recording.path().display().to_string(),
        };
        let points = choice.pick(
            "--points",
            wanted.points.as_deref(),
            &POINTS,
            &[Kind::PointCloud2],
        )?;
        let image = choice.pick("--image", wanted.image.as_deref(), &IMAGES, &IMAGES)?;
        let infos = [Kind::CameraInfo];
        let camera_info = match &wanted.camera_info {
            _ if wanted.camera.is_some() => None,
            Some(_) => Some(
                choice
                    .pick("--camera-info", wanted.camera_info.as_deref(), &infos, &[])?
                    .0,
            ),
            None => choice.beside(&image.0),
        };
        let depth_info = if points.1 == Kind::PointCloud2 {
            None
        } else {
            choice.beside(&points.0)
        };
        let transforms = [Kind::Transforms];
        let tf = if wanted.camera.is_some() {
            Vec::new()
        } else if wanted.tf.is_empty() {
            choice
                .of(&transforms)
                .map(|topic| topic.name.clone())
                .collect()
        } else {
            let picked = wanted
                .tf
                .iter()
                .map(|name| choice.pick("--tf", Some(name), &transforms, &[]));
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

    /// Checks that the cameras are there that points in another frame need.
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
        if self.points.1 != Kind::PointCloud2 && no_depth_camera {
            return Err(missing(&self.points.0, &self.depth_info));
        }
        Ok(())
    }
}

/// Whether the images of a topic are rectified, as `image_proc` calls them: `image_rect`, `image_rect_color`.
pub(super) fn is_rectified(topic: &str) -> bool {
    topic.split('/').any(|part| part.starts_with("image_rect"))
}

/// Topics to choose from.
struct Choice {
    topics: Vec<Arc<Topic>>,
    recording: String,
}

impl Choice {
    /// Those of some types.
    fn of<'a>(&'a self, kinds: &'a [Kind]) -> impl Iterator<Item = &'a Arc<Topic>> {
        let is =
            |topic: &&Arc<Topic>| Kind::of(&topic.kind).is_some_and(|kind| kinds.contains(&kind));
        self.topics.iter().filter(is)
    }

    /// The topic that an option names, or the only one of its usual types.
    fn pick(
        &self,
        option: &str,
        named: Option<&str>,
        kinds: &[Kind],
        usual: &[Kind],
    ) -> Result<(String, Kind)> {
        let Self { recording, .. } = self;
        let list = |kinds: &[Kind]| {
            let names: Vec<&str> = self.of(kinds).map(|topic| topic.name.as_str()).collect();
            if names.is_empty() {
                let types: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
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
            // Images of depths are no images to complete.
            let found = self.of(usual).filter(|topic| !topic.name.contains("epth"));
            let found: Vec<&Arc<Topic>> = found.collect();
            let what = match &found[..] {
                [topic] => return sound(topic, kinds),
                [] => format!("`{recording}` has no topic that {option} could be"),
                _ => format!("`{recording}` has several topics that {option} could be"),
            };
            let hint = format!(
                "give {option} TOPIC; {}",
                list(if found.is_empty() { kinds } else { usual })
            );
            return Err(Error::config(what).hint(hint));
        };
        let topic = self.topics.iter().find(|topic| topic.name == named);
        let Some(topic) = topic else {
            let what = format!("`{recording}` has no topic `{named}`");
            return Err(Error::config(what).hint(list(kinds)));
        };
        sound(topic, kinds).map_err(|error| match error.advice() {
            Some(_) => error,
            None => error.hint(list(kinds)),
        })
    }

    /// The camera of images: `camera_info` in the same place as their topic, or one above that.
    fn beside(&self, image: &str) -> Option<String> {
        let above = image.rsplit_once('/').map_or("", |(above, _)| above);
        let further = above.rsplit_once('/').map_or("", |(further, _)| further);
        let names = [above, further].map(|place| format!("{place}/camera_info"));
        let is_there = |name: &String| {
            self.of(&[Kind::CameraInfo])
                .any(|topic| topic.name == *name)
        };
        names.into_iter().find(is_there)
    }
}

/// What messages of ROS 2 are encoded in.
const CDR: &str = "cdr";
/// What to do about other encodings.
const ENCODED: &str = "messages of ROS 2 in cdr are read: convert recordings of ROS 1, as by rosbags-convert, and record json and protobuf \
                       (as of Foxglove) as sensor_msgs";

/// The name and type of a topic, if it is one of these.
fn sound(topic: &Topic, kinds: &[Kind]) -> Result<(String, Kind)> {
    let Topic {
        name,
        kind,
        encoding,
        ..
    } = topic;
    let Some(known) = Kind::of(kind).filter(|kind| kinds.contains(kind)) else {
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
