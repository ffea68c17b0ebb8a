//! Physical effects that the base model lacks, one file each.
//!
//! # Adding an effect
//!
//! One file and one word. Say that dust makes the rope heavier by a share of its own mass:
//!
//! 1. Write `effects/dust.rs`. It holds `pub const SPEC: EffectSpec` with equation, source, and
//!    parameters with unit, range, the value at which the effect vanishes and the smallest size of
//!    interest, and
//!    ```ignore
//!    pub fn add_to<T: Real>(values: &[T], physics: &mut Physics<T>) {
//!        physics.mass_laws.push(Box::new(Dust { share: values[0] }));
//!    }
//!    ```
//!    with a law that is generic over the number type, so that its tangents come by themselves.
//! 2. Add `dust` to `registry!` below, and its `mod` line.
//!
//! Nothing else knows effects by name: simulator, fit, diagnosis and report read the registry. The
//! kinds of laws, each a list of [`Physics`] and a trait, or one type, in [`crate::sim::physics`], are
//!
//! | an effect that changes | appends to | gives |
//! |---|---|---|
//! | a force on the rope | `force_laws` | N on a piece of rope, from place, velocity, tangent |
//! | the stress along the axis | `axial_laws` | coefficient of the cube of the strain |
//! | the stress by the history of strain | `memory_laws` | modulus and relaxation time of a [`crate::sim::physics::Maxwell`] element |
//! | the shape at rest | `shape_laws` | natural curvature along the rope |
//! | the shape for good | `flow_laws` | the strain below which nothing flows, the factor that brings a larger one back |
//! | the bending stiffness | `bending_laws` | a factor per slice |
//! | the mass | `mass_laws` | masses of the particles |
//! | where a grip is | `path_laws` | real pose minus recorded pose |
//! | what is seen | `observation_laws` | shift of the clock, displacement of a point |
//! | a coefficient | none: it changes gravity, friction, the release delay, the grip's angle or its pads in place | |
//!
//! Where the slope at the vanishing value is none or useless, the parameter says so ([`Slope`]), and fit
//! and score take a secant of the smallest size of interest. The laws that every effect must obey
//! are tested over the registry in `tests/tests/simulator/effects.rs` without a change there; each effect
//! is also checked against an exact result in `tests/tests/simulator/effect_physics.rs`.

mod air_drag;
mod bending_ratio;
mod camera_offset;
mod clamp_compliance;
mod clock_offset;
mod curvature_gradient;
mod density_gradient;
mod grip_angle;
mod gripper_lag;
mod internal_damping;
mod relaxation;
mod release_delay;
mod rest_curvature;
mod steady_wind;
mod strain_stiffening;
mod table_friction;
mod tilted_gravity;
mod tip_mass;
mod yield_strain;

use crate::sim::{Physics, Real};
use crate::words::significant;

/// A parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Name with unit suffix.
    pub name: &'static str,
    /// Unit for people; "1" for none.
    pub unit: &'static str,
    /// Value at which the effect is absent.
    pub vanishes_at: f64,
    /// Physically plausible values, lowest.
    pub low: f64,
    /// Physically plausible values, highest.
    pub high: f64,
    /// Smallest change of interest: the step of a secant, and the scale of a fit.
    pub smallest_of_interest: f64,
    /// How the rope's change with the parameter is found.
    pub slope: Slope,
    /// Whether its sign turns where the world is mirrored at the plane y = 0: by it a rope leaves that plane, and to
    /// first order by nothing else does. Of what bends at rest this holds for a rope that was not rolled.
    pub sideways: bool,
}

/// How the derivative with respect to a parameter is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Slope {
    /// From tangents, everywhere.
    Tangent,
    /// From a secant of the smallest size of interest where the parameter is nearer to its vanishing
    /// value than that, because the slope there is none or not of interest; elsewhere from tangents.
    SecantNearZero,
    /// From a secant everywhere: the parameter acts in jumps.
    Secant,
}

/// What an effect is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffectSpec {
    /// Name in files and messages.
    pub id: &'static str,
    /// Name for people.
    pub title: &'static str,
    /// Equation, in words of the module's documentation.
    pub equation: &'static str,
    /// Where the equation comes from.
    pub source: &'static str,
    /// Whether what it does is free in every other effect's score, as an unknown that no effect shall
    /// be blamed for; its own score then leaves that freedom out.
    pub nuisance: bool,
    /// Whether it is how somebody set the rig up, who would have seen much more than a few times its smallest size of
    /// interest.
    pub of_the_rig: bool,
    /// Whether it leaves the rope alone and only changes what cameras report.
    pub only_seen: bool,
    /// What people would call its size.
    pub quantity: Quantity,
    /// What to look at where a fit takes it to the end of its range, where that is known.
    pub at_its_end: Option<&'static str>,
    /// Parameters.
    pub parameters: &'static [ParameterSpec],
}

/// What people would call an effect's size, where its parameters are another function of that because they must vanish
/// where the effect does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// The parameters themselves.
    Itself,
    /// Of this name and unit: a vector w of which the parameters are |w| w.
    Square(&'static str, &'static str),
    /// Of this name, without unit: one over the parameter.
    Inverse(&'static str),
}

impl EffectSpec {
    /// Its size in what people would call it, if that is not what its parameters are.
    pub fn in_words(&self, values: &[f64]) -> Option<String> {
        match self.quantity {
            Quantity::Itself => None,
            Quantity::Square(name, unit) => {
                let root = values.iter().fold(0.0, |norm: f64, q| norm.hypot(*q)).sqrt();
                let of = |q: &f64| significant(if root > 0.0 { q / root } else { 0.0 });
                let components: Vec<String> = values.iter().map(of).collect();
                Some(format!("{name} of ({}) {unit}", components.join(", ")))
            }
            Quantity::Inverse(name) => {
                (values[0] != 0.0).then(|| format!("{name} of {}", significant(1.0 / values[0])))
            }
        }
    }

    /// The values of its parameters at which it changes nothing.
    pub fn vanishing(&self) -> impl Iterator<Item = f64> {
        self.parameters.iter().map(|p| p.vanishes_at)
    }
}

macro_rules! registry {
    ($($name:ident),* $(,)?) => {
        /// Every effect, in the order of the registry.
        pub const ALL: &[EffectSpec] = &[$($name::SPEC),*];

        /// Adds effect number `index` of [`ALL`] with the given parameter values to a physics.
        ///
        /// # Panics
        /// The index is not one of the registry, or the number of values is wrong.
        pub fn add_to<T: Real>(index: usize, values: &[T], physics: &mut Physics<T>) {
            assert_eq!(values.len(), ALL[index].parameters.len(), "one value per parameter");
            let adders = [$($name::add_to::<T>),*];
            adders[index](values, physics);
        }
    };
}

registry!(
    air_drag,
    internal_damping,
    table_friction,
    tilted_gravity,
    tip_mass,
    density_gradient,
    rest_curvature,
    curvature_gradient,
    bending_ratio,
    strain_stiffening,
    yield_strain,
    steady_wind,
    gripper_lag,
    clock_offset,
    release_delay,
    camera_offset,
    clamp_compliance,
    grip_angle,
    relaxation
);

/// Index of the effect with name `id`.
pub fn find(id: &str) -> Option<usize> {
    ALL.iter().position(|spec| spec.id == id)
}

/// The same, or who is known instead.
///
/// # Errors
/// No effect has that name.
pub fn known(id: &str) -> Result<usize, String> {
    find(id).ok_or_else(|| {
        let known: Vec<&str> = ALL.iter().map(|spec| spec.id).collect();
        format!("effect `{id}` is not known; known are {}", known.join(", "))
    })
}

/// One name for several effects, for people.
pub fn together(ids: &[String]) -> String {
    ids.join(" + ")
}
