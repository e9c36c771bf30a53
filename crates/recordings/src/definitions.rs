//! Definitions of the message types, stored in recordings for programs that lack them.

use crate::message::{DIAGNOSTIC_ARRAY, MessageType};

/// Name of the language of the definitions.
pub(crate) const LANGUAGE: &str = "ros2msg";

/// Separator between a type and the types of its fields.
const NEXT: &str =
    "\n================================================================================\nMSG: ";

const HEADER: &str = "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id";
const TIME: &str = "builtin_interfaces/Time\nint32 sec\nuint32 nanosec";
const IMAGE: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n\
    uint32 step\nuint8[] data";
const COMPRESSED: &str = "std_msgs/Header header\nstring format\nuint8[] data";
const CAMERA: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n\
    float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\nsensor_msgs/RegionOfInterest roi";
const WINDOW: &str = "sensor_msgs/RegionOfInterest\nuint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n\
    bool do_rectify";
const CLOUD: &str = "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n\
    bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense";
const FIELD: &str = "sensor_msgs/PointField\nuint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n\
    uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count";
const TRANSFORMS: &str = "geometry_msgs/TransformStamped[] transforms";
const STAMPED: &str = "geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\n\
    geometry_msgs/Transform transform";
const TRANSFORM: &str =
    "geometry_msgs/Transform\ngeometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation";
const VECTOR: &str = "geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z";
const QUATERNION: &str = "geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w";

const DIAGNOSTICS: &str = "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status";
const STATUS: &str = "diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\n\
    string name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values";
const VALUE: &str = "diagnostic_msgs/KeyValue\nstring key\nstring value";

/// Returns the definition of a supported type by its name, with the types of its fields, in the language `ros2msg` of MCAP.
/// `None` for other types.
pub fn message_definition(name: &str) -> Option<String> {
    if name == DIAGNOSTIC_ARRAY {
        return Some([DIAGNOSTICS, HEADER, TIME, STATUS, VALUE].join(NEXT));
    }
    MessageType::of(name).map(definition)
}

/// Returns the definition of a type, with the types of its fields.
pub(crate) fn definition(kind: MessageType) -> String {
    let parts: &[&str] = match kind {
        MessageType::Image => &[IMAGE, HEADER, TIME],
        MessageType::CompressedImage => &[COMPRESSED, HEADER, TIME],
        MessageType::CameraInfo => &[CAMERA, HEADER, TIME, WINDOW],
        MessageType::PointCloud2 => &[CLOUD, HEADER, TIME, FIELD],
        MessageType::Transforms => &[
            TRANSFORMS, STAMPED, HEADER, TIME, TRANSFORM, VECTOR, QUATERNION,
        ],
    };
    parts.join(NEXT)
}
