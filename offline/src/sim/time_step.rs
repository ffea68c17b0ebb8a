//! How long a time step is: what is stable on a scene's grid with the laws of a physics, and what the scene asks for.

use super::axial::modulus_pa;
use super::elastic::Lame;
use super::error::{Cause, SimError};
use super::material::Material;
use super::physics::Physics;
use super::real::{Arithmetic, Real};
use super::rollout::masses_kg;
use super::scene::{Scene, StepLength};

/// Share of the largest step that is stable for small motions of the undeformed rope that a step takes;
/// the rest is for large strains.
pub const STABLE_SHARE: f64 = 0.85;

/// ω² ρ dx² of the fastest oscillation on a grid is at most the first times λ plus the second times μ.
/// Measured by power iteration on ropes of 1.5 to 3 cells, ν from 0 to 0.49 and three alignments: up to 7 %
/// below this bound at 1.5 cells, up to a quarter at 3 (`the_bound_of_the_fastest_oscillation_holds`).
const FASTEST: [f64; 2] = [6.7, 5.9];

/// Largest speed that the time step provides for, m/s; above it a step moves too far.
const SPEED_BOUND_M_S: f64 = 10.0;
/// Largest motion in a step at that speed, cells.
const MOST_CELLS_PER_STEP: f64 = 0.4;

/// ω² ρ dx² of the fastest oscillation on a grid, Pa, at most.
pub fn fastest_pa<T: Arithmetic>(lame: &Lame<T>) -> T {
    lame.lambda.scale(FASTEST[0]) + lame.mu.scale(FASTEST[1])
}

impl Scene {
    /// Time step, s: [`Scene::step_share`] of the least of three: [`STABLE_SHARE`] of what is stable for the
    /// fastest oscillation of the grid, the bound ρ dx²/(6 η) of explicit viscosity, and some tenths of a
    /// cell per step at the speed bound. The first modulus is ω² ρ dx² of that oscillation, the second that of the stiffness
    /// which the material's loss goes with; with the damping ratio ζ that the loss's retardation time τ gives the
    /// oscillation, ω τ/2 where all of it is lossy, a symplectic step is stable up to (√(1 + ζ²) − ζ) 2/ω.
    pub fn time_step_s<T: Arithmetic>(&self, moduli_pa: [T; 2], viscosity_pa_s: f64, retardation_s: T) -> T {
        let [fastest_pa, lossy_pa] = moduli_pa;
        let density = self.rope.density_kg_m3();
        let dx = self.grid.spacing_m;
        let omega_rad_s = fastest_pa.scale(1.0 / (density * dx * dx)).sqrt();
        let ratio = (omega_rad_s * retardation_s).scale(0.5) * (lossy_pa / fastest_pa);
        let lossy = (T::one() + ratio * ratio).sqrt() - ratio;
        let stable_s = (lossy / omega_rad_s).scale(2.0 * STABLE_SHARE);
        let viscous_s = density * dx * dx / (6.0 * viscosity_pa_s.max(f64::MIN_POSITIVE));
        let still_s = MOST_CELLS_PER_STEP * dx / SPEED_BOUND_M_S;
        let least_s = T::of(viscous_s.min(still_s));
        T::select(stable_s.exceeds(least_s), least_s, stable_s).scale(self.step_share)
    }

    /// The time step that [`Self::step`] asks for, s, where `longest_s` is the one of all laws.
    ///
    /// # Errors
    /// A fixed step that is not stable.
    pub fn chosen_step_s(&self, longest_s: f64) -> Result<f64, SimError> {
        let limit_s = longest_s / STABLE_SHARE;
        match self.step {
            StepLength::Longest => Ok(longest_s),
            StepLength::Fixed(dt_s) if dt_s > 0.0 && dt_s <= limit_s => Ok(dt_s),
            StepLength::Fixed(dt_s) => Err(SimError::at_start(Cause::StepTooLong {
                dt_s,
                longest_s: limit_s,
            })),
        }
    }
}

/// The time step of a scene with all laws of a physics, s. A piece that is lighter than the rope as declared counts as that
/// much stiffer, because wave speed and diffusivity go with their ratio.
pub fn time_step_s<T: Real>(scene: &Scene, physics: &Physics<T>) -> f64 {
    let lame = physics.lame();
    // A stiffness of another kind counts with the factor of λ, the larger.
    let stiff = |modulus_pa: T| {
        fastest_pa(&Lame {
            mu: T::zero(),
            lambda: modulus_pa,
        })
    };
    let stiffening = physics.cubic_pa(&lame).map_or(T::zero(), modulus_pa);
    let lossy_pa = fastest_pa(&lame);
    let elastic = lossy_pa * stiffest_bending(scene, physics) + stiff(stiffening);
    let lightness = lightness(scene, physics);
    let memory_laws = || physics.memory_laws.iter();
    let viscosity: f64 = memory_laws()
        .map(|law| law.viscosity(&lame).p_wave_modulus().value())
        .sum();
    let quick = memory_laws().fold(T::zero(), |sum, law| sum + fastest_pa(&law.quick(&lame)));
    let retardation_s = physics.retardation_s(&scene.rope);
    let of = |fastest_pa: T, viscosity_pa_s: f64| {
        scene.time_step_s(
            [fastest_pa, lossy_pa].map(|pa| pa.scale(lightness)),
            viscosity_pa_s * lightness,
            retardation_s,
        )
    };
    let (slow, fast) = (of(elastic, viscosity), of(elastic + quick, 0.0));
    T::select(slow.exceeds(fast), slow, fast).value()
}

/// Declared density over the least that the laws leave, at least one.
fn lightness<T: Real>(scene: &Scene, physics: &Physics<T>) -> f64 {
    if physics.mass_laws.is_empty() {
        return 1.0;
    }
    let layout = scene.layout();
    let density = scene.rope.density_kg_m3();
    let masses = masses_kg(scene, physics, &layout);
    let declared = |p| T::of(density * layout.particle_volume_m3(p)).value();
    let ratios = masses.iter().enumerate().map(|(p, m)| declared(p) / m.value());
    ratios.fold(1.0, f64::max)
}

/// Largest bending stiffness of a slice as a multiple of the solid section's, at least one.
fn stiffest_bending<T: Real>(scene: &Scene, physics: &Physics<T>) -> T {
    if physics.bending_laws.is_empty() {
        return T::one();
    }
    Material::new(physics, &scene.layout()).largest_bending()
}
