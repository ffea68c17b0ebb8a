//! Small vectors and matrices over any number type; matrices are row-major, `m[row][column]`.

use super::real::{Arithmetic, Real};

/// A vector of three components.
pub type Vec3<T> = [T; 3];
/// A 3 × 3 matrix.
pub type Mat3<T> = [[T; 3]; 3];

/// Zero vector.
#[inline(always)]
pub fn zero3<T: Arithmetic>() -> Vec3<T> {
    [T::zero(); 3]
}

/// The constants of `v` as numbers of type `T`.
#[inline(always)]
pub fn lift3<T: Arithmetic>(v: [f64; 3]) -> Vec3<T> {
    [T::of(v[0]), T::of(v[1]), T::of(v[2])]
}

/// The values of `v` without derivatives.
#[inline(always)]
pub fn value3<T: Real>(v: Vec3<T>) -> [f64; 3] {
    [v[0].value(), v[1].value(), v[2].value()]
}

/// a + b.
#[inline(always)]
pub fn add<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// a − b.
#[inline(always)]
pub fn sub<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// a s.
#[inline(always)]
pub fn mul<T: Arithmetic>(a: Vec3<T>, s: T) -> Vec3<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// a c with a constant c.
#[inline(always)]
pub fn scaled<T: Arithmetic>(a: Vec3<T>, c: f64) -> Vec3<T> {
    [a[0].scale(c), a[1].scale(c), a[2].scale(c)]
}

/// The components of `yes` where the mask holds, of `no` elsewhere.
#[inline(always)]
pub fn select3<T: Arithmetic>(mask: T::Mask, yes: Vec3<T>, no: Vec3<T>) -> Vec3<T> {
    [
        T::select(mask, yes[0], no[0]),
        T::select(mask, yes[1], no[1]),
        T::select(mask, yes[2], no[2]),
    ]
}

/// a · b.
#[inline(always)]
pub fn dot<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b.
#[inline(always)]
pub fn cross<T: Arithmetic>(a: Vec3<T>, b: Vec3<T>) -> Vec3<T> {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// |a|; its derivative at a = 0 does not exist and is not finite.
#[inline(always)]
pub fn norm<T: Arithmetic>(a: Vec3<T>) -> T {
    dot(a, a).sqrt()
}

/// a/|a|; not finite at a = 0.
#[inline(always)]
pub fn direction<T: Arithmetic>(a: Vec3<T>) -> Vec3<T> {
    mul(a, T::one() / norm(a))
}

/// Identity matrix.
#[inline(always)]
pub fn identity<T: Arithmetic>() -> Mat3<T> {
    let (o, l) = (T::zero(), T::one());
    [[l, o, o], [o, l, o], [o, o, l]]
}

/// A + B.
#[inline(always)]
pub fn matadd<T: Arithmetic>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    [add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2])]
}

/// A B.
#[inline(always)]
pub fn matmul<T: Arithmetic>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let mut c = [[T::zero(); 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            c[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j];
        }
    }
    c
}

/// A Bᵀ.
#[inline(always)]
pub fn matmul_transposed<T: Arithmetic>(a: &Mat3<T>, b: &Mat3<T>) -> Mat3<T> {
    let mut c = [[T::zero(); 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            c[i][j] = a[i][0] * b[j][0] + a[i][1] * b[j][1] + a[i][2] * b[j][2];
        }
    }
    c
}

/// Aᵀ.
#[inline(always)]
pub fn transpose<T: Arithmetic>(a: &Mat3<T>) -> Mat3<T> {
    [
        [a[0][0], a[1][0], a[2][0]],
        [a[0][1], a[1][1], a[2][1]],
        [a[0][2], a[1][2], a[2][2]],
    ]
}

/// A v.
#[inline(always)]
pub fn matvec<T: Arithmetic>(a: &Mat3<T>, v: Vec3<T>) -> Vec3<T> {
    [dot(a[0], v), dot(a[1], v), dot(a[2], v)]
}

/// det A.
#[inline(always)]
pub fn det<T: Arithmetic>(a: &Mat3<T>) -> T {
    dot(a[0], cross(a[1], a[2]))
}

/// A⁻ᵀ, the cofactor matrix over the determinant.
#[inline(always)]
pub fn transpose_inverse<T: Arithmetic>(a: &Mat3<T>) -> Mat3<T> {
    let cofactors = [cross(a[1], a[2]), cross(a[2], a[0]), cross(a[0], a[1])];
    let inverse_det = T::one() / dot(a[0], cofactors[0]);
    [
        mul(cofactors[0], inverse_det),
        mul(cofactors[1], inverse_det),
        mul(cofactors[2], inverse_det),
    ]
}

/// Rotation matrix of a vector of Rodrigues: along the axis, as long as the tangent of half the angle.
pub fn rotation_of_rodrigues<T: Arithmetic>(v: Vec3<T>) -> Mat3<T> {
    let w = T::one() / (T::one() + dot(v, v)).sqrt();
    rotation_of_quaternion([v[0] * w, v[1] * w, v[2] * w, w])
}

/// Rotation matrix of a unit quaternion (x, y, z, w).
pub fn rotation_of_quaternion<T: Arithmetic>(q: [T; 4]) -> Mat3<T> {
    let [x, y, z, w] = q;
    let two = |a: T| a.scale(2.0);
    [
        [
            T::one() - two(y * y + z * z),
            two(x * y - z * w),
            two(x * z + y * w),
        ],
        [
            two(x * y + z * w),
            T::one() - two(x * x + z * z),
            two(y * z - x * w),
        ],
        [
            two(x * z - y * w),
            two(y * z + x * w),
            T::one() - two(x * x + y * y),
        ],
    ]
}
