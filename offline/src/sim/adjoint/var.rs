//! A number that remembers how it came about: reverse mode for whatever the laws of effects compute.
//!
//! Every operation writes its inputs and slopes to a tape that belongs to the thread. One sweep back
//! over the tape then gives the derivatives of one result with respect to everything, so an effect
//! needs no code of its own for reverse mode and may have any number of parameters. The numbers are
//! `f64`, also where the rollout runs in `f32`.
//!
//! The tape is used in two layers. Its foot holds how coefficients and laws follow from the
//! parameters, is written once per gradient and swept once, at the end. On top of it each particle,
//! step after step, writes what its laws compute, sweeps that part and takes it off again.

use crate::sim::real::{Arithmetic, Real, Triple};
use crate::sim::tensor::{Mat3, matmul, transpose, transpose_inverse};
use std::cell::RefCell;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// A number on the tape; place 0 stands for all constants.
#[derive(Clone, Copy, Debug)]
pub struct Var {
    value: f64,
    place: u32,
}

/// One operation: where its inputs stand, the slopes towards them, and the derivative of the result
/// with respect to its outcome.
#[derive(Clone, Copy)]
struct Entry {
    inputs: [u32; 2],
    slopes: [f64; 2],
    adjoint: f64,
}

const CONSTANT: Entry = Entry {
    inputs: [0; 2],
    slopes: [0.0; 2],
    adjoint: 0.0,
};

thread_local! {
    static TAPE: RefCell<Vec<Entry>> = const { RefCell::new(Vec::new()) };
}

fn write(value: f64, inputs: [u32; 2], slopes: [f64; 2]) -> Var {
    TAPE.with_borrow_mut(|tape| {
        let place = tape.len() as u32;
        tape.push(Entry {
            inputs,
            slopes,
            adjoint: 0.0,
        });
        Var { value, place }
    })
}

/// The use of this thread's tape. Numbers of an earlier session mean nothing in a later one.
pub(super) struct Session(());

impl Session {
    /// Takes the tape.
    ///
    /// # Panics
    /// The thread has an open session already.
    pub(super) fn open() -> Self {
        TAPE.with_borrow_mut(|tape| {
            assert!(tape.is_empty(), "a thread computes one gradient at a time");
            tape.push(CONSTANT);
        });
        Self(())
    }

    /// A number with respect to which derivatives are wanted.
    pub(super) fn input(&self, value: f64) -> Var {
        write(value, [0; 2], [0.0; 2])
    }

    /// Where the tape ends now.
    pub(super) fn mark(&self) -> usize {
        TAPE.with_borrow(Vec::len)
    }

    /// Adds to the derivative of the result with respect to a number.
    pub(super) fn seed(&self, var: Var, adjoint: f64) {
        TAPE.with_borrow_mut(|tape| tape[var.place as usize].adjoint += adjoint);
    }

    /// Carries the derivatives of all numbers above `mark` on to what they were made of.
    pub(super) fn sweep(&self, mark: usize) {
        TAPE.with_borrow_mut(|tape| {
            for place in (mark..tape.len()).rev() {
                let Entry {
                    inputs,
                    slopes,
                    adjoint,
                } = tape[place];
                if adjoint != 0.0 {
                    tape[inputs[0] as usize].adjoint += slopes[0] * adjoint;
                    tape[inputs[1] as usize].adjoint += slopes[1] * adjoint;
                }
            }
        });
    }

    /// Derivative of the result with respect to a number, after a sweep.
    pub(super) fn adjoint(&self, var: Var) -> f64 {
        TAPE.with_borrow(|tape| tape[var.place as usize].adjoint)
    }

    /// Takes everything above `mark` off the tape.
    pub(super) fn rewind(&self, mark: usize) {
        TAPE.with_borrow_mut(|tape| {
            tape.truncate(mark);
            tape[0] = CONSTANT;
        });
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        TAPE.with_borrow_mut(Vec::clear);
    }
}

impl Var {
    /// f(self) with the slope f'(self).
    fn chain(self, value: f64, slope: f64) -> Self {
        match self.place {
            0 => Self { value, place: 0 },
            place => write(value, [place, 0], [slope, 0.0]),
        }
    }

    /// f(a, b) with its two slopes.
    fn join(a: Self, b: Self, value: f64, slopes: [f64; 2]) -> Self {
        if a.place == 0 && b.place == 0 {
            return Self { value, place: 0 };
        }
        write(value, [a.place, b.place], slopes)
    }
}

impl Add for Var {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self::join(self, b, self.value + b.value, [1.0, 1.0])
    }
}

impl Sub for Var {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        Self::join(self, b, self.value - b.value, [1.0, -1.0])
    }
}

impl Mul for Var {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Self::join(self, b, self.value * b.value, [b.value, self.value])
    }
}

impl Div for Var {
    type Output = Self;
    fn div(self, b: Self) -> Self {
        let (inverse, value) = (1.0 / b.value, self.value / b.value);
        Self::join(self, b, value, [inverse, -value * inverse])
    }
}

impl Neg for Var {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl AddAssign for Var {
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl SubAssign for Var {
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

impl Arithmetic for Var {
    type Mask = bool;

    fn of(value: f64) -> Self {
        Self { value, place: 0 }
    }
    fn scale(self, c: f64) -> Self {
        self.chain(self.value * c, c)
    }
    fn times_plus(self, b: Self, c: Self) -> Self {
        self * b + c
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn exceeds(self, bound: Self) -> bool {
        self.value > bound.value
    }
    fn select(mask: bool, yes: Self, no: Self) -> Self {
        if mask { yes } else { no }
    }
    fn everywhere(mask: bool) -> bool {
        mask
    }

    /// The value, and around it the linear map of [`super::stress`] as operations.
    fn polar_rotation(f: &Mat3<Self>) -> Mat3<Self> {
        let value = f.map(|row| row.map(Self::value));
        let r = f64::polar_rotation(&value);
        let s = matmul(&transpose(&r), &value);
        let trace = s[0][0] + s[1][1] + s[2][2];
        let system =
            std::array::from_fn(|i| std::array::from_fn(|j| if i == j { trace - s[i][j] } else { -s[i][j] }));
        let inverse = transpose(&transpose_inverse(&system));
        let turned = matmul(&transpose(&r).map(|row| row.map(Self::of)), f);
        let axial = [
            turned[2][1] - turned[1][2],
            turned[0][2] - turned[2][0],
            turned[1][0] - turned[0][1],
        ];
        let spin = inverse.map(|c| axial[0].scale(c[0]) + axial[1].scale(c[1]) + axial[2].scale(c[2]));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (p, q) = ((j + 1) % 3, (j + 2) % 3);
                let change = spin[q].scale(r[i][p]) - spin[p].scale(r[i][q]);
                change.chain(r[i][j], 1.0)
            })
        })
    }
}

impl Real for Var {
    type Base = f64;
    type Packed = Triple<Self>;

    fn pack(v: [Self; 3]) -> Triple<Self> {
        Triple(v)
    }
    fn unpack(v: Triple<Self>) -> [Self; 3] {
        v.0
    }
    fn packed_times(v: Triple<Self>, c: f64) -> Triple<Self> {
        Triple(v.0.map(|x| x.scale(c)))
    }
    fn base(value: f64) -> f64 {
        value
    }
    fn times(self, c: f64) -> Self {
        self.scale(c)
    }
    fn value(self) -> f64 {
        self.value
    }
    fn exp(self) -> Self {
        let value = self.value.exp();
        self.chain(value, value)
    }
    fn sin_cos(self) -> (Self, Self) {
        let (sin, cos) = self.value.sin_cos();
        (self.chain(sin, cos), self.chain(cos, -sin))
    }
}
