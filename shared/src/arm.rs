//! The xArm7: modified Denavit-Hartenberg table, forward kinematics, Jacobian and the limits that
//! every target obeys. Base frame: origin at the foot, z up, x forward; radians and metres.
//!
//! Sources: UFACTORY `kinematic-and-dynamic-parameters` (table), `p04robot-specifications` (speed,
//! acceleration, jerk, flange speed), xArm-Python-SDK `x_config.py` (joint ranges of both serials).

use crate::blob::TaskFrame;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// Number of joints.
pub const JOINTS: usize = 7;

/// Seven joint values: angles (rad) or their rates (rad/s).
pub type Joints = [f64; JOINTS];

/// One row of the modified table: cos and sin of alpha(i-1), a(i-1) and d(i) in m.
struct Link {
    cos_alpha: f64,
    sin_alpha: f64,
    a_m: f64,
    d_m: f64,
}

const fn link(sin_alpha: f64, a_m: f64, d_m: f64) -> Link {
    // Every alpha is 0 or ±90°, so the cosine is 1 or 0 exactly.
    let cos_alpha = if sin_alpha == 0.0 { 1.0 } else { 0.0 };
    Link {
        cos_alpha,
        sin_alpha,
        a_m,
        d_m,
    }
}

const LINKS: [Link; JOINTS] = [
    link(0.0, 0.0, 0.267),
    link(-1.0, 0.0, 0.0),
    link(1.0, 0.0, 0.293),
    link(1.0, 0.0525, 0.0),
    link(1.0, 0.0775, 0.3425),
    link(1.0, 0.0, 0.0),
    link(-1.0, 0.076, 0.097),
];

const TURN: f64 = 2.0 * core::f64::consts::PI;

/// Lowest joint angles, rad: the narrower of both hardware revisions (before and from serial 1305).
pub const LOWEST_RAD: Joints = [-TURN, -2.042035, -TURN, -0.10472, -TURN, -1.692969, -TURN];

/// Highest joint angles, rad: the narrower of both hardware revisions.
pub const HIGHEST_RAD: Joints = [TURN, 2.024581, TURN, 3.92699, TURN, core::f64::consts::PI, TURN];

/// Largest joint speed, rad/s (180 °/s).
pub const SPEED_MAX_RAD_S: f64 = core::f64::consts::PI;

/// Largest joint acceleration, rad/s² (1145 °/s²).
pub const ACCELERATION_MAX_RAD_S2: f64 = 20.0;

/// Largest joint jerk, rad/s³ (28647 °/s³).
pub const JERK_MAX_RAD_S3: f64 = 500.0;

/// Largest flange speed, m/s; the control box faults (C60) at 1.2 times this value.
pub const FLANGE_SPEED_MAX_M_S: f64 = 1.0;

/// A posture whose tool points level along +x, in the middle of the joint ranges: the seed of inverse
/// kinematics and what its redundancy is drawn towards. Joint 5 is turned by half a turn because
/// then every point of the task keeps 0.3 rad to its limits; with joint 5 at zero joint 6 runs out.
pub const LEVEL_POSTURE_RAD: Joints = [0.0, 0.2, 0.0, 1.0, core::f64::consts::PI, 1.3, 0.0];

/// Where the task stands when nothing else is said: the robot looks along the task's +x, and every
/// point of the task is reached 0.4 rad or more inside the joint ranges.
pub const DEFAULT_TASK_FRAME: TaskFrame = TaskFrame {
    origin_m: [0.35, 0.0, 0.12],
    yaw_rad: 0.0,
};

/// Position and orientation of the flange in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlangePose {
    /// Position, m.
    pub position_m: Vector3<f64>,
    /// Columns are the flange's axes; z is where the tool points.
    pub rotation: Matrix3<f64>,
}

impl FlangePose {
    /// The flange at `position_m` with its tool level and pointing along x turned by `yaw_rad` about z.
    pub fn level(position_m: [f64; 3], yaw_rad: f64) -> Self {
        let (sin, cos) = (libm::sin(yaw_rad), libm::cos(yaw_rad));
        Self {
            position_m: Vector3::from(position_m),
            // The tool's x axis points down and its z axis forward, as in LEVEL_POSTURE_RAD.
            rotation: Matrix3::new(0.0, -sin, cos, 0.0, cos, sin, -1.0, 0.0, 0.0),
        }
    }
}

/// The flange at a point (x, z) of the task plane, tool level and along the task's +x.
pub fn task_pose(frame: &TaskFrame, point_m: [f64; 2]) -> FlangePose {
    FlangePose::level(frame.flange_m(point_m), frame.yaw_rad)
}

/// What one pass along the chain yields: the flange and, per joint, its axis and a point on it.
struct Chain {
    flange: FlangePose,
    axis: [Vector3<f64>; JOINTS],
    origin_m: [Vector3<f64>; JOINTS],
}

/// T(i) = Rx(alpha) Tx(a) Rz(theta) Tz(d), multiplied up from the base.
fn chain(q_rad: &Joints) -> Chain {
    let mut rotation = Matrix3::identity();
    let mut position = Vector3::zeros();
    let mut axis = [Vector3::zeros(); JOINTS];
    let mut origin_m = [Vector3::zeros(); JOINTS];
    for i in 0..JOINTS {
        let Link {
            cos_alpha: ca,
            sin_alpha: sa,
            a_m,
            d_m,
        } = LINKS[i];
        let (s, c) = (libm::sin(q_rad[i]), libm::cos(q_rad[i]));
        position += rotation * Vector3::new(a_m, -sa * d_m, ca * d_m);
        rotation *= Matrix3::new(c, -s, 0.0, ca * s, ca * c, -sa, sa * s, sa * c, ca);
        axis[i] = rotation.column(2).into_owned();
        origin_m[i] = position;
    }
    Chain {
        flange: FlangePose {
            position_m: position,
            rotation,
        },
        axis,
        origin_m,
    }
}

/// Forward kinematics: the flange for joint angles in rad.
pub fn flange(q_rad: &Joints) -> FlangePose {
    chain(q_rad).flange
}

/// Forward kinematics and the geometric Jacobian: rows 0..3 are the flange's velocity (m per rad),
/// rows 3..6 its angular velocity in the base frame (rad per rad).
pub fn flange_and_jacobian(q_rad: &Joints) -> (FlangePose, SMatrix<f64, 6, 7>) {
    let chain = chain(q_rad);
    let mut jacobian = SMatrix::<f64, 6, JOINTS>::zeros();
    for i in 0..JOINTS {
        let lever_m = chain.flange.position_m - chain.origin_m[i];
        let linear = chain.axis[i].cross(&lever_m);
        jacobian.fixed_view_mut::<3, 1>(0, i).copy_from(&linear);
        jacobian.fixed_view_mut::<3, 1>(3, i).copy_from(&chain.axis[i]);
    }
    (chain.flange, jacobian)
}

/// The first joint (from 0) whose angle is outside its range or not a number.
pub fn joint_out_of_range(q_rad: &Joints) -> Option<usize> {
    (0..JOINTS).find(|&i| !(q_rad[i] >= LOWEST_RAD[i] && q_rad[i] <= HIGHEST_RAD[i]))
}

/// Distance of the joint nearest to its limit, rad; negative outside.
pub fn margin_rad(q_rad: &Joints) -> f64 {
    (0..JOINTS)
        .map(|i| (q_rad[i] - LOWEST_RAD[i]).min(HIGHEST_RAD[i] - q_rad[i]))
        .fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::PI;
    use nalgebra::Matrix4;
    use proptest::prelude::*;

    /// Positions (m) and orientations (row by row) from UFACTORY's standard table, computed in Python.
    const GOLDEN: [(Joints, [f64; 3], [f64; 9]); 5] = [
        (
            [0.0; 7],
            [0.206, 0.0, 0.1205],
            [1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0],
        ),
        (
            [0.3, -0.5, 0.2, 0.9, -0.4, 0.7, 0.1],
            [0.325988387945, 0.19536838229, 0.538307928195],
            [
                0.557786348,
                0.411524926,
                0.720778485,
                0.582291483,
                -0.812868208,
                0.013487208,
                0.591448238,
                0.412180193,
                -0.693034249,
            ],
        ),
        (
            [1.0, 0.5, -1.0, 1.5, 1.0, -0.5, 2.0],
            [0.546205538606, 0.050654977963, 0.542440720138],
            [
                -0.115853151,
                0.334986975,
                0.935073138,
                -0.568328618,
                0.749721153,
                -0.338999667,
                -0.814604585,
                -0.570703004,
                0.103525127,
            ],
        ),
        (
            [-2.0, -1.2, 2.5, 2.8, -1.7, 2.2, -3.0],
            [0.384160819965, 0.488212540825, 0.510776038999],
            [
                -0.721169114,
                0.683347699,
                0.113802599,
                -0.404269837,
                -0.281729811,
                -0.870169071,
                -0.562566448,
                -0.673546016,
                0.479431702,
            ],
        ),
        (
            [0.0, 0.2, 0.0, 1.8, 0.0, 0.03, 0.0],
            [0.546815095397, 0.0, 0.707119890277],
            [
                0.000796327,
                0.0,
                0.999999683,
                0.0,
                -1.0,
                0.0,
                0.999999683,
                0.0,
                -0.000796327,
            ],
        ),
    ];

    /// The chain of the standard table (alpha, a, d after the joint): the independent twin.
    fn standard(q: &Joints) -> Matrix4<f64> {
        let rows = [
            (-PI / 2.0, 0.0, 0.267),
            (PI / 2.0, 0.0, 0.0),
            (PI / 2.0, 0.0525, 0.293),
            (PI / 2.0, 0.0775, 0.0),
            (PI / 2.0, 0.0, 0.3425),
            (-PI / 2.0, 0.076, 0.0),
            (0.0, 0.0, 0.097),
        ];
        rows.iter()
            .zip(q)
            .fold(Matrix4::identity(), |t, (&(alpha, a, d), &theta)| {
                let (s, c) = (libm::sin(theta), libm::cos(theta));
                let (sa, ca) = (libm::sin(alpha), libm::cos(alpha));
                t * Matrix4::new(
                    c,
                    -s * ca,
                    s * sa,
                    a * c,
                    s,
                    c * ca,
                    -c * sa,
                    a * s,
                    0.0,
                    sa,
                    ca,
                    d,
                    0.0,
                    0.0,
                    0.0,
                    1.0,
                )
            })
    }

    #[test]
    fn golden_poses() {
        for (q, position, rotation) in GOLDEN {
            let pose = flange(&q);
            assert!(
                (pose.position_m - Vector3::from(position)).norm() < 1e-11,
                "{q:?}"
            );
            assert!(
                (pose.rotation - Matrix3::from_row_slice(&rotation)).norm() < 1e-8,
                "{q:?}"
            );
        }
    }

    #[test]
    fn the_level_posture_points_forward() {
        let pose = flange(&LEVEL_POSTURE_RAD);
        let level = FlangePose::level(pose.position_m.into(), 0.0);
        // Joints 2, 4 and 6 are round numbers, so the tool is level to a few degrees only.
        assert!((pose.rotation - level.rotation).norm() < 0.9, "{}", pose.rotation);
        assert!((level.rotation.determinant() - 1.0).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn modified_and_standard_tables_agree(q in prop::array::uniform7(-PI..PI)) {
            let (pose, twin) = (flange(&q), standard(&q));
            prop_assert!((pose.position_m - twin.fixed_view::<3, 1>(0, 3)).norm() < 1e-13);
            prop_assert!((pose.rotation - twin.fixed_view::<3, 3>(0, 0)).norm() < 1e-13);
        }

        #[test]
        fn jacobian_is_the_derivative(q in prop::array::uniform7(-PI..PI), joint in 0usize..7) {
            let (pose, jacobian) = flange_and_jacobian(&q);
            let step = 1e-6;
            let (mut ahead, mut behind) = (q, q);
            ahead[joint] += step;
            behind[joint] -= step;
            let (ahead, behind) = (flange(&ahead), flange(&behind));
            let linear = (ahead.position_m - behind.position_m) / (2.0 * step);
            let turn = (ahead.rotation - behind.rotation) / (2.0 * step) * pose.rotation.transpose();
            let angular = Vector3::new(turn[(2, 1)], turn[(0, 2)], turn[(1, 0)]);
            prop_assert!((linear - jacobian.fixed_view::<3, 1>(0, joint)).norm() < 1e-8);
            prop_assert!((angular - jacobian.fixed_view::<3, 1>(3, joint)).norm() < 1e-8);
        }
    }

    #[test]
    fn ranges_refuse_nan_and_beyond() {
        assert_eq!(joint_out_of_range(&LEVEL_POSTURE_RAD), None);
        let mut q = LEVEL_POSTURE_RAD;
        q[3] = f64::NAN;
        assert_eq!(joint_out_of_range(&q), Some(3));
        q[3] = HIGHEST_RAD[3] + 1e-9;
        assert_eq!(joint_out_of_range(&q), Some(3));
        assert!(margin_rad(&q) < 0.0 && margin_rad(&LEVEL_POSTURE_RAD) > 0.9);
    }
}
