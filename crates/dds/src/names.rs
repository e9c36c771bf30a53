//! Names of ROS 2 topics and types in DDS.

use crate::{Error, Result};

/// The DDS name of a topic: `rt/camera/image_raw` for `/camera/image_raw`.
///
/// # Errors
///
/// The name is not absolute, has empty parts, or characters other than letters, digits and `_`.
pub(crate) fn topic(name: &str) -> Result<String> {
    let is_valid = name.strip_prefix('/').is_some_and(|parts| {
        parts.split('/').all(|part| {
            part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        })
    });
    if is_valid {
        Ok(format!("rt{name}"))
    } else {
        Err(Error::Name {
            name: name.into(),
            what: "topic",
            example: "/camera/image_raw",
        })
    }
}

/// The DDS name of a type: `sensor_msgs::msg::dds_::Image_` for `sensor_msgs/msg/Image`.
///
/// # Errors
///
/// The name does not have the form `package/msg/Type`.
pub(crate) fn message_type(name: &str) -> Result<String> {
    let is_valid = |part: &str| {
        part.starts_with(|c: char| c.is_ascii_alphabetic())
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    };
    match *name.split('/').collect::<Vec<_>>() {
        [package, "msg", message] if is_valid(package) && is_valid(message) => {
            Ok(format!("{package}::msg::dds_::{message}_"))
        }
        _ => Err(Error::Name {
            name: name.into(),
            what: "type",
            example: "sensor_msgs/msg/Image",
        }),
    }
}

/// The ROS name of a DDS topic; `None` if it belongs to something else, such as a service.
pub(crate) fn ros_topic(dds: &str) -> Option<&str> {
    dds.strip_prefix("rt").filter(|name| name.starts_with('/'))
}

/// The ROS name of a DDS type.
pub(crate) fn ros_type(dds: &str) -> Option<String> {
    let (package, message) = dds.strip_suffix('_')?.split_once("::msg::dds_::")?;
    Some(format!("{package}/msg/{message}"))
}

/// The hash of a type (REP 2011), which ROS 2 from Iron on shows and may compare; `None` for types that are not listed.
pub(crate) fn type_hash(ros: &str) -> Option<&'static str> {
    Some(match ros {
        "sensor_msgs/msg/Image" => {
            "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
        }
        "sensor_msgs/msg/CompressedImage" => {
            "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"
        }
        "sensor_msgs/msg/CameraInfo" => {
            "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"
        }
        "sensor_msgs/msg/PointCloud2" => {
            "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"
        }
        "tf2_msgs/msg/TFMessage" => {
            "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
        }
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `design.ros2.org/articles/topic_and_service_names.html` and `rmw_fastrtps` have them.
    #[test]
    fn names_are_mangled_as_by_ros() {
        for (ros, dds) in [
            ("/camera/image_raw", "rt/camera/image_raw"),
            ("/tf_static", "rt/tf_static"),
        ] {
            assert_eq!(topic(ros).ok().as_deref(), Some(dds));
            assert_eq!(ros_topic(dds), Some(ros));
        }
        for (ros, dds) in [
            ("sensor_msgs/msg/Image", "sensor_msgs::msg::dds_::Image_"),
            ("tf2_msgs/msg/TFMessage", "tf2_msgs::msg::dds_::TFMessage_"),
        ] {
            assert_eq!(message_type(ros).ok().as_deref(), Some(dds));
            assert_eq!(ros_type(dds).as_deref(), Some(ros));
        }
        assert_eq!(ros_topic("rq/node/get_parametersRequest"), None);
    }

    #[test]
    fn other_names_are_refused() {
        for name in ["camera", "", "/", "/a//b", "/a/", "/1a", "/a b", "/a~"] {
            assert!(topic(name).is_err(), "{name}");
        }
        for name in [
            "sensor_msgs/Image",
            "sensor_msgs/srv/Image",
            "a/msg/",
            "/msg/A",
        ] {
            assert!(message_type(name).is_err(), "{name}");
        }
    }
}
