//! Arguments of `complete` for recordings.

use clap::{Args as ClapArgs, ValueEnum};
use serde::Serialize;

/// What is completed of a recording, and how it is written.
#[derive(Clone, Debug, ClapArgs, Serialize)]
#[command(next_help_heading = "Recordings")]
pub(in crate::cli) struct Recorded {
    /// Topic of the images, as `lsdc inspect` lists them (images or compressed images) [default: the only one].
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pub(in crate::cli) image: Option<String>,
    /// Topic of the points: clouds, or images of depths (16UC1 in --depth-unit, 32FC1, or compressed)
    /// [default: the only one of clouds].
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pub(in crate::cli) points: Option<String>,
    /// Topic of the camera of the images [default: `camera_info` beside the images]. --camera FILE replaces
    /// it and the transforms: its pose is that of the camera in the frame of the points.
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pub(in crate::cli) camera_info: Option<String>,
    /// Topic of transforms, tf2's; may be repeated [default: all].
    #[arg(long, value_name = "TOPIC", hide_short_help = true)]
    pub(in crate::cli) tf: Vec<String>,
    /// Frame in which the motion between the times of points and image is measured [default: odom, or the topmost
    /// frame].
    #[arg(long, value_name = "FRAME", hide_short_help = true)]
    pub(in crate::cli) fixed_frame: Option<String>,
    /// How many seconds the points may be off an image; images without such points are left out, and counted.
    #[arg(long, value_name = "SECONDS", default_value_t = USUAL, value_parser = seconds, hide_short_help = true)]
    pub(in crate::cli) tolerance: f64,
    /// Take all points of a cloud at its stamp. Else points with times of their own (a field `t`, `time`, `timestamp`, `time_stamp`,
    /// `offset_time` or `time_offset`) are seen from where the scanner was at these; those that transforms do not reach are left
    /// out, and counted.
    #[arg(long, hide_short_help = true)]
    pub(in crate::cli) no_deskew: bool,
    /// With -o FILE.mcap: depths in m (32FC1) or mm (16UC1).
    #[arg(long, value_enum, default_value = "m", hide_short_help = true)]
    #[serde(skip)]
    pub(in crate::cli) units: Units,
    /// With -o FILE.mcap: also write the depths as clouds.
    #[arg(long, hide_short_help = true)]
    #[serde(skip)]
    pub(in crate::cli) cloud: bool,
    /// With -o FILE.mcap: also copy all messages of the recording, unchanged.
    #[arg(long, hide_short_help = true)]
    #[serde(skip)]
    pub(in crate::cli) copy: bool,
}

const USUAL: f64 = 0.05;

/// What depths are written in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Units {
    /// Metres.
    M,
    /// Millimetres.
    Mm,
}

impl Units {
    pub(in crate::cli) fn is_millimetres(self) -> bool {
        self == Self::Mm
    }
}

impl Recorded {
    /// The options that were given.
    pub(in crate::cli) fn given(&self) -> Vec<&'static str> {
        let options = [
            ("--image", self.image.is_some()),
            ("--points", self.points.is_some()),
            ("--camera-info", self.camera_info.is_some()),
            ("--tf", !self.tf.is_empty()),
            ("--fixed-frame", self.fixed_frame.is_some()),
            ("--tolerance", self.tolerance != USUAL),
            ("--no-deskew", self.no_deskew),
        ];
        let given = options.into_iter().filter(|(_, given)| *given);
        given.map(|(name, _)| name).chain(self.of_bags()).collect()
    }

    /// Those that are for results in a recording alone.
    pub(in crate::cli) fn of_bags(&self) -> Option<&'static str> {
        let options = [
            ("--units", self.units != Units::M),
            ("--cloud", self.cloud),
            ("--copy", self.copy),
        ];
        options
            .into_iter()
            .find(|(_, given)| *given)
            .map(|(name, _)| name)
    }
}

/// A number of seconds that is not below 0, and at most a day.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let found = text
        .parse()
        .ok()
        .filter(|seconds| (0.0..=86_400.0).contains(seconds));
    found.ok_or_else(|| "is no number of seconds, as in 0.05".to_owned())
}
