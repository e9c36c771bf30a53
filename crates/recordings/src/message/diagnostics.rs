//! `diagnostic_msgs/msg/DiagnosticArray`: the state of the parts of a robot, for `rqt_robot_monitor` and the like.

use super::{Header, Timestamp};
use crate::cdr::CdrWriter;

/// Type of these messages.
pub const DIAGNOSTIC_ARRAY: &str = "diagnostic_msgs/msg/DiagnosticArray";

/// Severity of the state of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum DiagnosticLevel {
    /// It works as expected.
    Ok = 0,
    /// It works, but with degraded results.
    Warn = 1,
    /// It does not work.
    Error = 2,
    /// No data arrived for a while.
    Stale = 3,
}

/// The state of a part.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DiagnosticStatus {
    /// Severity.
    pub level: DiagnosticLevel,
    /// Name of the part.
    pub name: String,
    /// Description of the state, in one line.
    pub message: String,
    /// Identifier of the device.
    pub hardware_id: String,
    /// Names and values of measurements.
    pub values: Vec<(String, String)>,
}

/// Writes a message with the states of parts at a time.
pub fn write_diagnostics(stamp: Timestamp, parts: &[DiagnosticStatus]) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(1024);
    let header = Header {
        stamp,
        frame: String::new(),
    };
    header.write(&mut writer);
    writer.u32(parts.len() as u32);
    for part in parts {
        writer.u8(part.level as u8);
        for text in [&part.name, &part.message, &part.hardware_id] {
            writer.string(text);
        }
        writer.u32(part.values.len() as u32);
        for (name, value) in &part.values {
            writer.string(name);
            writer.string(value);
        }
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The expected bytes were serialised by `rosbags` 0.11.
    #[test]
    fn the_message_is_that_of_ros() {
        const EXPECTED: &str = "000100000700000005000000010000000000000002000000010000000c0000006c7364633a20646570746800\
            050000006c61746500000000050000006c736463000000000200000007000000696d6167657300000300000031320000080000007175616c\
            697479000500000066756c6c0000000002000000620000000100000000000000010000000000000000000000";
        let part = |level, name: &str, message: &str, hardware: &str| DiagnosticStatus {
            level,
            name: name.to_owned(),
            message: message.to_owned(),
            hardware_id: hardware.to_owned(),
            values: Vec::new(),
        };
        let text = |(name, value): (&str, &str)| (name.to_owned(), value.to_owned());
        let parts = [
            DiagnosticStatus {
                values: [("images", "12"), ("quality", "full")].map(text).into(),
                ..part(DiagnosticLevel::Warn, "lsdc: depth", "late", "lsdc")
            },
            part(DiagnosticLevel::Ok, "b", "", ""),
        ];
        let message = write_diagnostics(7_000_000_005, &parts);
        let bytes = (0..EXPECTED.len()).step_by(2);
        let bytes = bytes.map(|at| u8::from_str_radix(&EXPECTED[at..at + 2], 16).unwrap());
        assert!(bytes.eq(message), "{parts:?}");
    }
}
