//! A discrete elastic rod in three dimensions: a chain of point masses with stretching and bending
//! energies (Bergou et al. 2008, "Discrete elastic rods"). Straight at rest, circular section, so
//! twist carries no energy and is left out. Shares no code with the simulator that it judges.

use nalgebra::Vector3;
use std::f64::consts::PI;

/// What a rod is made of and how finely it is cut.
#[derive(Clone, Debug)]
pub struct RodSpec {
    /// Length, m.
    pub length_m: f64,
    /// Diameter, m.
    pub diameter_m: f64,
    /// Mass, kg, spread evenly.
    pub mass_kg: f64,
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Number of equal segments.
    pub segments: usize,
    /// Retardation time of stretching (Kelvin-Voigt), s: keeps stiff axial waves from ringing.
    pub axial_retardation_s: f64,
    /// Retardation time of bending (Kelvin-Voigt), s.
    pub bending_retardation_s: f64,
}

/// Positions, velocities and forces of the chain's nodes.
#[derive(Clone, Debug)]
pub struct Rod {
    /// Node positions from the rope's start to its end, m.
    pub x: Vec<Vector3<f64>>,
    /// Node velocities, m/s.
    pub v: Vec<Vector3<f64>>,
    /// Node masses, kg.
    pub mass: Vec<f64>,
    /// Share of the rope's length that belongs to each node, m.
    pub share_m: Vec<f64>,
    /// Bending stiffness at each inner node over the length it stands for, N m; the ends have none.
    pub bending: Vec<f64>,
    /// Length of rope whose bend each node stands for, m.
    pub bend_m: Vec<f64>,
    /// Natural curvature about −y, 1/m: of a rod along x, upwards. The axis does not turn with the rod,
    /// so this is for motion in the plane of x and z.
    pub natural_per_m: f64,
    /// Coefficient c of the stress E ε (1 + c ε²).
    pub stiffening: f64,
    /// E ∫ y⁴ dA, N m⁴: what stiffening multiplies in bending.
    pub fourth_n_m4: f64,
    /// Rest length of a segment, m.
    pub rest_m: f64,
    /// Stretching stiffness, N.
    pub axial: f64,
    /// See [`RodSpec::axial_retardation_s`].
    pub axial_retardation_s: f64,
    /// See [`RodSpec::bending_retardation_s`].
    pub bending_retardation_s: f64,
    edges: Vec<Edge>,
}

/// A segment's state, computed once a step.
#[derive(Clone, Copy, Debug, Default)]
struct Edge {
    tangent: Vector3<f64>,
    length_m: f64,
    /// Velocity of the far node against the near one, m/s.
    rate: Vector3<f64>,
}

impl Rod {
    /// A straight rod at rest from `start_m` along the unit vector `direction`.
    pub fn straight(spec: &RodSpec, start_m: Vector3<f64>, direction: Vector3<f64>) -> Self {
        let n = spec.segments;
        let rest_m = spec.length_m / n as f64;
        let second_moment = PI * spec.diameter_m.powi(4) / 64.0;
        let area = PI * spec.diameter_m.powi(2) / 4.0;
        let share = |i: usize| if i == 0 || i == n { 0.5 * rest_m } else { rest_m };
        let share_m: Vec<f64> = (0..=n).map(share).collect();
        let inner = |i: usize| i != 0 && i != n;
        let bend = spec.young_pa * second_moment / rest_m;
        Self {
            x: (0..=n)
                .map(|i| start_m + direction * (i as f64 * rest_m))
                .collect(),
            v: vec![Vector3::zeros(); n + 1],
            mass: share_m.iter().map(|s| spec.mass_kg * s / spec.length_m).collect(),
            share_m,
            bending: (0..=n).map(|i| if inner(i) { bend } else { 0.0 }).collect(),
            bend_m: vec![rest_m; n + 1],
            natural_per_m: 0.0,
            stiffening: 0.0,
            // ∫ y⁴ dA = π R⁶/8 over a disc.
            fourth_n_m4: spec.young_pa * PI * (0.5 * spec.diameter_m).powi(6) / 8.0,
            rest_m,
            axial: spec.young_pa * area,
            axial_retardation_s: spec.axial_retardation_s,
            bending_retardation_s: spec.bending_retardation_s,
            edges: vec![Edge::default(); n],
        }
    }

    /// Adds the elastic and viscous forces of the present state to `force`, N.
    pub fn add_forces(&mut self, force: &mut [Vector3<f64>]) {
        for j in 0..self.edges.len() {
            let along = self.x[j + 1] - self.x[j];
            let length_m = along.norm();
            self.edges[j] = Edge {
                tangent: along / length_m,
                length_m,
                rate: self.v[j + 1] - self.v[j],
            };
        }
        self.add_stretching(force);
        self.add_bending(force);
    }

    /// Kelvin-Voigt stretching: tension EA (ε + τ dε/dt) along each segment.
    fn add_stretching(&self, force: &mut [Vector3<f64>]) {
        for (j, edge) in self.edges.iter().enumerate() {
            let strain = edge.length_m / self.rest_m - 1.0;
            let strain_rate = edge.tangent.dot(&edge.rate) / self.rest_m;
            let elastic = strain + self.stiffening * strain.powi(3);
            let pull = edge.tangent * (self.axial * (elastic + self.axial_retardation_s * strain_rate));
            force[j] += pull;
            force[j + 1] -= pull;
        }
    }

    /// Bending with the discrete curvature of Bergou et al. (2008, eq. 1), |κb| = 2 tan(θ/2).
    ///
    /// With c = cos θ between neighbouring tangents the energy B/2 |κb|² is 2B (1 − c)/(1 + c), so
    /// dE/dc = −4B/(1 + c)² and the force follows from dc/de₀ = (t₁ − c t₀)/|e₀|. A stiffening stress adds the
    /// moment c E ∫y⁴dA κ³, a natural curvature the energy −B κb·k (`natural_force`). The viscous part
    /// resists the difference of the neighbours' angular velocities t × ṫ with the torque B τ Δω,
    /// which is exact for motion in a plane.
    fn add_bending(&self, force: &mut [Vector3<f64>]) {
        let viscous = self.bending_retardation_s > 0.0;
        for i in 1..self.edges.len() {
            let (near, far) = (&self.edges[i - 1], &self.edges[i]);
            let (t0, t1) = (&near.tangent, &far.tangent);
            let stiffness = self.bending[i];
            let c = t0.dot(t1);
            let square = 4.0 * (1.0 - c) / (1.0 + c);
            let quartic = self.stiffening * self.fourth_n_m4 / self.bend_m[i].powi(3);
            let slope = 4.0 * (stiffness + quartic * square) / (1.0 + c).powi(2);
            let mut on_near = (t1 - t0 * c) * (slope / near.length_m);
            let mut on_far = (t0 - t1 * c) * (slope / far.length_m);
            if self.natural_per_m != 0.0 {
                let natural = Vector3::new(0.0, -self.natural_per_m * self.bend_m[i], 0.0);
                on_near += natural_force(t0, t1, &natural) * (stiffness / near.length_m);
                on_far -= natural_force(t1, t0, &natural) * (stiffness / far.length_m);
            }
            if viscous {
                let w0 = t0.cross(&near.rate) / near.length_m;
                let w1 = t1.cross(&far.rate) / far.length_m;
                let torque = (w1 - w0) * (stiffness * self.bending_retardation_s);
                on_near += torque.cross(t0) / near.length_m;
                on_far -= torque.cross(t1) / far.length_m;
            }
            // `on_near` and `on_far` pull at the far end of their segment, and back at its near end.
            force[i - 1] -= on_near;
            force[i] += on_near - on_far;
            force[i + 1] += on_far;
        }
    }

    /// Largest stable step of the explicit integrator, s, with a margin of two.
    ///
    /// Gershgorin's circles around the chain's stiffness matrix bound ω²: a segment of stiffness k
    /// adds 2k/m to its nodes, a bend of stiffness B adds 4, 8 and 4 times B/(m h²) to its three.
    /// Symplectic Euler needs ω dt < 2 and, with damping, τ ω² dt < 2.
    pub fn stable_step_s(&self) -> f64 {
        let last = self.mass.len() - 1;
        let (mut axial, mut bending) = (0f64, 0f64);
        for i in 0..=last {
            let segments = if i == 0 || i == last { 1.0 } else { 2.0 };
            axial = axial.max(2.0 * segments * self.axial / (self.rest_m * self.mass[i]));
            let near = if i > 0 { self.bending[i - 1] } else { 0.0 };
            let far = if i < last { self.bending[i + 1] } else { 0.0 };
            let bends = 4.0 * near + 8.0 * self.bending[i] + 4.0 * far;
            bending = bending.max(bends / (self.mass[i] * self.rest_m.powi(2)));
        }
        let elastic = 2.0 / (axial + bending).sqrt();
        let viscous = 2.0 / (self.axial_retardation_s * axial + self.bending_retardation_s * bending);
        0.5 * elastic.min(viscous)
    }

    /// Stored elastic energy, J.
    pub fn elastic_energy_j(&self) -> f64 {
        let mut energy = 0.0;
        for j in 0..self.edges.len() {
            let strain = (self.x[j + 1] - self.x[j]).norm() / self.rest_m - 1.0;
            let stiffer = 1.0 + 0.5 * self.stiffening * strain * strain;
            energy += 0.5 * self.axial * self.rest_m * strain * strain * stiffer;
        }
        for i in 1..self.edges.len() {
            let t0 = (self.x[i] - self.x[i - 1]).normalize();
            let t1 = (self.x[i + 1] - self.x[i]).normalize();
            let c = t0.dot(&t1);
            let square = 4.0 * (1.0 - c) / (1.0 + c);
            let natural = self.natural_per_m * self.bend_m[i];
            let about_y = 2.0 * t0.cross(&t1).y / (1.0 + c);
            let quartic = self.stiffening * self.fourth_n_m4 / self.bend_m[i].powi(3);
            energy += self.bending[i] * (0.5 * (square + natural * natural) + natural * about_y)
                + 0.25 * quartic * square * square;
        }
        energy
    }

    /// Sum of the nodes' momenta, kg m/s.
    pub fn momentum(&self) -> Vector3<f64> {
        let pairs = self.mass.iter().zip(&self.v);
        pairs.map(|(m, v)| v * *m).sum()
    }
}

/// Part across t₀ of d(κb·k)/dt₀ with κb = 2 t₀ × t₁/(1 + t₀·t₁). Swapping the tangents turns the sign.
fn natural_force(t0: &Vector3<f64>, t1: &Vector3<f64>, natural: &Vector3<f64>) -> Vector3<f64> {
    let (c, bent) = (1.0 + t0.dot(t1), t0.cross(t1).dot(natural));
    let slope = t1.cross(natural) * (2.0 / c) - t1 * (2.0 * bent / (c * c));
    slope - t0 * t0.dot(&slope)
}
