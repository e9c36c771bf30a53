//! Quality of service: what writers offer and readers request.

/// How messages of a topic are transferred, as in a profile of ROS 2 (`QoS`). History is always "keep last".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Lost messages are sent again, as long as the writer keeps them. A reader that requests this is not matched with
    /// a writer that does not offer it.
    pub reliable: bool,
    /// The last messages are kept for readers that join later (`TRANSIENT_LOCAL`), as on `/tf_static`. A reader that
    /// requests this is not matched with a writer that does not offer it.
    pub transient_local: bool,
    /// Number of messages that a writer keeps to send again, and that wait for a slow subscriber; at least 1. Older ones
    /// are dropped, and counted.
    pub depth: usize,
}

impl Qos {
    /// Best effort, 5 messages: `rmw_qos_profile_sensor_data`, for images and clouds.
    pub const SENSOR_DATA: Self = Self {
        reliable: false,
        transient_local: false,
        depth: 5,
    };

    /// Reliable, 10 messages: `rmw_qos_profile_default`.
    pub const DEFAULT: Self = Self {
        reliable: true,
        transient_local: false,
        depth: 10,
    };

    /// Reliable, and the last message is kept for late subscribers: `/tf_static` (which every publisher of
    /// transforms writes once) and latched topics.
    pub const LATCHED: Self = Self {
        reliable: true,
        transient_local: true,
        depth: 1,
    };

    /// Whether this offer satisfies a reader that requests `requested`.
    pub(crate) fn satisfies(self, requested: Self) -> bool {
        (self.reliable || !requested.reliable)
            && (self.transient_local || !requested.transient_local)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tables of "Quality of Service settings" in the documentation of ROS 2.
    #[test]
    fn compatible_as_in_the_tables_of_ros() {
        let best_effort = Qos::SENSOR_DATA;
        assert!(best_effort.satisfies(best_effort));
        assert!(!best_effort.satisfies(Qos::DEFAULT));
        assert!(Qos::DEFAULT.satisfies(best_effort));
        assert!(Qos::DEFAULT.satisfies(Qos::DEFAULT));
        assert!(!Qos::DEFAULT.satisfies(Qos::LATCHED));
        assert!(Qos::LATCHED.satisfies(Qos::DEFAULT));
        assert!(Qos::LATCHED.satisfies(Qos::LATCHED));
    }
}
