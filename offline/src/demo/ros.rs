//! The ROS 2 messages that a recording of a rope holds: their fields, their CDR encoding as
//! `ros2 bag record` stores it, and their definitions as viewers want them.

use byteorder::LittleEndian;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// `builtin_interfaces/msg/Time`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Time {
    pub sec: i32,
    pub nanosec: u32,
}

/// `std_msgs/msg/Header`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `sensor_msgs/msg/PointField`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PointField {
    pub name: String,
    pub offset: u32,
    pub datatype: u8,
    pub count: u32,
}

/// Values of [`PointField::datatype`].
pub(super) const FLOAT32: u8 = 7;
pub(super) const FLOAT64: u8 = 8;

/// `sensor_msgs/msg/PointCloud2`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PointCloud2 {
    pub header: Header,
    pub height: u32,
    pub width: u32,
    pub fields: Vec<PointField>,
    pub is_bigendian: bool,
    pub point_step: u32,
    pub row_step: u32,
    pub data: Vec<u8>,
    pub is_dense: bool,
}

/// `geometry_msgs/msg/PoseStamped`, its nested messages flattened: CDR knows no nesting.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PoseStamped {
    pub header: Header,
    pub position_m: [f64; 3],
    pub quaternion_xyzw: [f64; 4],
}

/// `sensor_msgs/msg/JointState`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct JointState {
    pub header: Header,
    pub name: Vec<String>,
    pub position: Vec<f64>,
    pub velocity: Vec<f64>,
    pub effort: Vec<f64>,
}

/// `std_msgs/msg/Bool`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Bool {
    pub data: bool,
}

/// A message with its name and its definition.
pub(super) trait Message: Serialize + DeserializeOwned {
    /// Name of the type.
    const NAME: &'static str;
    /// Definition with those of nested messages, encoding `ros2msg`.
    const DEFINITION: &'static str;
}

/// Encapsulation of CDR: representation (big- or little-endian) and options.
const LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// The bytes of a message, encapsulation first.
pub(super) fn encode<M: Message>(message: &M) -> Result<Vec<u8>, String> {
    let mut bytes = LITTLE_ENDIAN.to_vec();
    let body = cdr_encoding::to_vec::<M, LittleEndian>(message).map_err(|e| e.to_string())?;
    bytes.extend(body);
    Ok(bytes)
}

/// The message in some bytes.
pub(super) fn decode<M: Message>(bytes: &[u8]) -> Result<M, String> {
    let (head, body) = bytes.split_first_chunk::<4>().ok_or("the message is cut short")?;
    if head[..2] != LITTLE_ENDIAN[..2] {
        return Err(format!("the message is not little-endian CDR ({head:?})"));
    }
    let decoded = cdr_encoding::from_bytes::<M, LittleEndian>(body);
    decoded.map(|(message, _)| message).map_err(|e| e.to_string())
}

macro_rules! definition {
    ($own:literal $(, $name:literal: $body:expr)* $(,)?) => {
        concat!(
            $own,
            $("================================================================================\n",
              "MSG: ", $name, "\n", $body),*
        )
    };
}

macro_rules! header {
    () => {
        "builtin_interfaces/Time stamp\nstring frame_id\n"
    };
}
macro_rules! time {
    () => {
        "int32 sec\nuint32 nanosec\n"
    };
}

impl Message for PointCloud2 {
    const NAME: &'static str = "sensor_msgs/msg/PointCloud2";
    const DEFINITION: &'static str = definition!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\n\
         uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        "std_msgs/Header": header!(),
        "builtin_interfaces/Time": time!(),
        "sensor_msgs/PointField": "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\n\
            uint8 UINT32=6\nuint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\n\
            uint32 count\n",
    );
}

impl Message for PoseStamped {
    const NAME: &'static str = "geometry_msgs/msg/PoseStamped";
    const DEFINITION: &'static str = definition!(
        "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        "std_msgs/Header": header!(),
        "builtin_interfaces/Time": time!(),
        "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
        "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n",
    );
}

impl Message for JointState {
    const NAME: &'static str = "sensor_msgs/msg/JointState";
    const DEFINITION: &'static str = definition!(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        "std_msgs/Header": header!(),
        "builtin_interfaces/Time": time!(),
    );
}

impl Message for Bool {
    const NAME: &'static str = "std_msgs/msg/Bool";
    const DEFINITION: &'static str = "bool data\n";
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of a PoseStamped as the CDR rules give them: strings with length and final zero,
    /// doubles aligned to eight bytes after the encapsulation.
    #[test]
    fn a_pose_is_encoded_byte_by_byte_as_cdr_says() {
        let pose = PoseStamped {
            header: Header {
                stamp: Time { sec: 3, nanosec: 500 },
                frame_id: "world".into(),
            },
            position_m: [1.0, 2.0, 3.0],
            quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
        };
        let mut bytes = vec![0, 1, 0, 0, 3, 0, 0, 0, 0xf4, 1, 0, 0, 6, 0, 0, 0];
        bytes.extend(b"world\0");
        // 18 bytes so far after the encapsulation; the next multiple of eight is 24.
        bytes.extend([0; 6]);
        for x in [1.0f64, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0] {
            bytes.extend(x.to_le_bytes());
        }
        assert_eq!(encode(&pose).unwrap(), bytes);
        assert_eq!(decode::<PoseStamped>(&bytes).unwrap(), pose);
        assert!(decode::<PoseStamped>(&bytes[..40]).is_err());
    }
}
