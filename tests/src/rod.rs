//! A discrete elastic rod in three dimensions: a chain of point masses, and between two of them a segment whose
//! section has a normal of its own, the director. It stretches, shears and bends (Reissner 1973; discrete as in
//! Gazzola et al. 2018, "Forward and inverse problems in the mechanics of soft filaments"; the curvature is that of
//! Bergou et al. 2008, "Discrete elastic rods", with directors in place of tangents), and its sections have rotary
//! inertia: a rope is so thick that its third mode is several percent slower than without both. Circular section;
//! a vector of its material in every section carries twist and natural curvature. Shares no code with the simulator
//! that it judges.

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
    /// Poisson's ratio: of it are the shear modulus and the share of the section that carries shear.
    pub poisson: f64,
    /// What a bent section does besides.
    pub section: BentSection,
    /// Number of equal segments.
    pub segments: usize,
    /// Retardation time of its material (Kelvin-Voigt), s: of stretch, shear, bend and twist alike.
    pub retardation_s: f64,
}

/// What a solid round section of radius r adds to Euler's law in second order of curvature κ, its bent fibres squeezing
/// it (Brazier 1927): M = EI κ (1 − `softening` (κr)²) − 2 `lengthening` r² κ N, and the axis stretches by
/// N/EA + `lengthening` (κr)². The moment is written as EI κ/(1 + `softening` (κr)²), the same in this order, which a sharp
/// bend leaves stable. Per length the energy is EA/2 (ε − `lengthening` (κr)²)² + EI ln(1 + p κ²)/2p with p = `softening` r².
#[derive(Clone, Copy, Debug, Default)]
pub struct BentSection {
    /// Share of the moment that is missing, over (κr)².
    pub softening: f64,
    /// Stretch of the axis without axial force, over (κr)².
    pub lengthening: f64,
}

impl BentSection {
    /// Of fixed-corotated material with Poisson's ratio 0.3: the least energy of a section in pure bending, its
    /// displacements polynomials of the fifth degree (a minimisation with SciPy, which no program here takes part in).
    pub const SOLID: Self = Self {
        softening: 0.515,
        lengthening: 0.163,
    };
}

/// Positions, velocities and forces of the chain's nodes.
#[derive(Clone, Debug)]
pub struct Rod {
    /// Node positions from the rope's start to its end, m.
    pub x: Vec<Vector3<f64>>,
    /// Node velocities, m/s.
    pub v: Vec<Vector3<f64>>,
    /// Directors of the segments: unit normals of their sections.
    pub directors: Vec<Vector3<f64>>,
    /// Unit vectors in the sections that turn with the material: about them a natural curvature bends.
    pub sides: Vec<Vector3<f64>>,
    /// Angular velocities of the sections, 1/s.
    pub turning: Vec<Vector3<f64>>,
    /// Node masses, kg.
    pub mass: Vec<f64>,
    /// Share of the rope's length that belongs to each node, m.
    pub share_m: Vec<f64>,
    /// Bending stiffness at each inner node over the length it stands for, N m; the ends have none.
    pub bending: Vec<f64>,
    /// Length of rope whose bend each node stands for, m.
    pub bend_m: Vec<f64>,
    /// Share of each node's bend that is the rope's own: less than one where a clamp that gives takes the rest.
    pub bend_share: Vec<f64>,
    /// Natural curvature about the sides at each node, 1/m: of a rod along x, upwards.
    pub natural_per_m: Vec<f64>,
    /// Coefficient c of the stress E ε (1 + c ε²).
    pub stiffening: f64,
    /// E ∫ y⁴ dA, N m⁴: what stiffening multiplies in bending.
    pub fourth_n_m4: f64,
    /// Rest length of a segment, m.
    pub rest_m: f64,
    /// Stretching stiffness, N.
    pub axial: f64,
    /// Shear stiffness κ G A, N, with Cowper's κ = 6 (1 + ν)/(7 + 6 ν) of a disc (1966).
    pub shear: f64,
    /// See [`BentSection`].
    pub section: BentSection,
    /// Square of the section's radius, m².
    pub square_radius_m2: f64,
    /// Rotary inertia of a segment about a diameter of its section, kg m²; about its axis it is twice that.
    pub inertia: f64,
    /// Stiffness against twist between two segments, G 2I over their distance, N m.
    pub twist: f64,
    /// The side of the straight rod.
    side: Vector3<f64>,
    /// See [`RodSpec::retardation_s`].
    pub retardation_s: f64,
    torques: Vec<Vector3<f64>>,
    /// Square of each node's bend, as `square_bend` says.
    square_bends: Vec<f64>,
    /// Elastic tension of each segment, N.
    tensions: Vec<f64>,
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
        // Of a rod along x, −y.
        let across = Vector3::y() - direction * direction.y;
        let side = -across.try_normalize(1e-9).unwrap_or_else(Vector3::x);
        Self {
            x: (0..=n)
                .map(|i| start_m + direction * (i as f64 * rest_m))
                .collect(),
            v: vec![Vector3::zeros(); n + 1],
            directors: vec![direction; n],
            sides: vec![side; n],
            turning: vec![Vector3::zeros(); n],
            mass: share_m.iter().map(|s| spec.mass_kg * s / spec.length_m).collect(),
            share_m,
            bending: (0..=n).map(|i| if inner(i) { bend } else { 0.0 }).collect(),
            bend_m: vec![rest_m; n + 1],
            bend_share: vec![1.0; n + 1],
            natural_per_m: vec![0.0; n + 1],
            stiffening: 0.0,
            // ∫ y⁴ dA = π R⁶/8 over a disc.
            fourth_n_m4: spec.young_pa * PI * (0.5 * spec.diameter_m).powi(6) / 8.0,
            rest_m,
            axial: spec.young_pa * area,
            // κ G A with G = E/(2 (1 + ν)).
            shear: 3.0 / (7.0 + 6.0 * spec.poisson) * spec.young_pa * area,
            section: spec.section,
            square_radius_m2: 0.25 * spec.diameter_m.powi(2),
            inertia: spec.mass_kg / area * second_moment / n as f64,
            retardation_s: spec.retardation_s,
            twist: bend / (1.0 + spec.poisson),
            side,
            torques: vec![Vector3::zeros(); n],
            square_bends: vec![0.0; n + 1],
            tensions: vec![0.0; n],
        }
    }

    /// Adds the elastic and viscous forces of the present state to `force`, N, and takes down the torques on the
    /// directors.
    pub fn add_forces(&mut self, force: &mut [Vector3<f64>]) {
        self.torques.fill(Vector3::zeros());
        for node in 0..self.x.len() {
            self.square_bends[node] = self.square_bend(node);
        }
        self.add_stretching(force);
        self.add_bending();
    }

    /// Torques on the directors as [`Self::add_forces`] took them down, N m.
    pub fn torques(&self) -> &[Vector3<f64>] {
        &self.torques
    }

    /// Turns the sections by a step of the torques that were taken down.
    pub fn turn(&mut self, dt_s: f64) {
        for j in 0..self.directors.len() {
            let director = self.directors[j];
            let turning = self.turning[j];
            // Angular momentum over the inertia: about the axis that is twice as large.
            let spin = turning + director * turning.dot(&director) + self.torques[j] * (dt_s / self.inertia);
            let turning = spin - director * (0.5 * spin.dot(&director));
            let director = (director + turning.cross(&director) * dt_s).normalize();
            let side = self.sides[j] + turning.cross(&self.sides[j]) * dt_s;
            self.sides[j] = (side - director * side.dot(&director)).normalize();
            self.directors[j] = director;
            self.turning[j] = spin - director * (0.5 * spin.dot(&director));
        }
    }

    /// Holds a segment's section as it was in the straight rod.
    pub fn hold(&mut self, segment: usize, director: Vector3<f64>) {
        self.directors[segment] = director;
        self.sides[segment] = self.side;
        self.turning[segment] = Vector3::zeros();
    }

    /// A segment's strains: along its director, less what the bend of its two nodes lengthens it by, and across it.
    fn strains(&self, segment: usize, square_bends: [f64; 2]) -> (f64, Vector3<f64>) {
        let along = (self.x[segment + 1] - self.x[segment]) / self.rest_m;
        let director = &self.directors[segment];
        let stretch = along.dot(director);
        let longer = [0, 1].map(|end| square_bends[end] * self.lengthening(segment + end));
        (
            stretch - 1.0 - 0.5 * (longer[0] + longer[1]) / self.rest_m,
            along - director * stretch,
        )
    }

    /// Square u² of a node's bend away from its natural one: |κb|² − 2 κb·k + k², κb and k as in `add_bending`; the ends
    /// have none.
    fn square_bend(&self, node: usize) -> f64 {
        if node == 0 || node == self.directors.len() {
            return 0.0;
        }
        let [near, far] = [&self.directors[node - 1], &self.directors[node]];
        let c = near.dot(far);
        let natural = self.natural_per_m[node] * self.bend_m[node];
        let about_side = near.cross(far).dot(&(self.sides[node - 1] + self.sides[node])) / (1.0 + c);
        4.0 * (1.0 - c) / (1.0 + c) + natural * (natural - 2.0 * about_side)
    }

    /// Factor q of the energy q/4 u⁴ that a stiffening stress adds at a node, N m.
    fn quartic(&self, node: usize) -> f64 {
        self.stiffening * self.fourth_n_m4 / self.bend_m[node].powi(3)
    }

    /// p κ² of a node that is bent by u², for the p of [`BentSection`]. In series with a clamp that gives, the rope's
    /// moment falls behind with the third power of its share of the bend.
    fn squeezed(&self, node: usize, square: f64) -> f64 {
        let square_per_m2 = square / self.bend_m[node].powi(2);
        self.section.softening * self.square_radius_m2 * square_per_m2 * self.bend_share[node].powi(3)
    }

    /// By how much a node's bend lengthens the axis, m, over its u².
    fn lengthening(&self, node: usize) -> f64 {
        self.section.lengthening * self.square_radius_m2 * self.bend_share[node].powi(2) / self.bend_m[node]
    }

    /// Kelvin-Voigt stretching and shear: the segment e pulls with n = EA (ε + τ ε') d + κGA (γ + τ γ') and turns its
    /// director with e × n, strains as in `strains` and the rates of e as the director sees them.
    fn add_stretching(&mut self, force: &mut [Vector3<f64>]) {
        for j in 0..self.directors.len() {
            let (strain, across) = self.strains(j, [self.square_bends[j], self.square_bends[j + 1]]);
            let director = self.directors[j];
            let along = self.x[j + 1] - self.x[j];
            let seen = (self.v[j + 1] - self.v[j] - self.turning[j].cross(&along)) / self.rest_m;
            let strain_rate = seen.dot(&director);
            let late = self.retardation_s;
            self.tensions[j] = self.axial * (strain + self.stiffening * strain.powi(3));
            let pull = director * (self.tensions[j] + self.axial * late * strain_rate)
                + (across + (seen - director * strain_rate) * late) * self.shear;
            force[j] += pull;
            force[j + 1] -= pull;
            self.torques[j] += along.cross(&pull);
        }
    }

    /// Bending and twist, with the discrete curvature of Bergou et al. (2008, eq. 1), |κb| = 2 tan(θ/2), of neighbouring
    /// directors.
    ///
    /// With c = cos θ between them and k the natural curvature along the mean of the sides, the bend that stresses the
    /// material has the square u² = 4 (1 − c)/(1 + c) − 2 κb·k + k², and B/2 u² is its energy, so its slopes are those
    /// of c and κb·k. A squeezed section takes from B, stiffening stress adds to it, and the tension of a lengthening
    /// bend changes it.
    /// The twist φ has the energy C (1 − cos φ), (1 + c) cos φ being the sum of the products of both vectors across the
    /// directors. The viscous part resists the difference Δω of the neighbours' angular velocities: with B τ Δω across
    /// the rope, with C τ Δω along it.
    fn add_bending(&mut self) {
        for i in 1..self.directors.len() {
            let [near, far] = [self.directors[i - 1], self.directors[i]];
            let [own, other] = [self.sides[i - 1], self.sides[i]];
            let c = near.dot(&far);
            let square = self.square_bends[i];
            let pulled = self.lengthening(i) * (self.tensions[i - 1] + self.tensions[i]);
            let round = self.bending[i] / (1.0 + self.squeezed(i, square));
            let stiffness = round + self.quartic(i) * square - pulled;
            let elastic = near.cross(&far) * (4.0 * stiffness / (1.0 + c).powi(2));
            let viscous = self.resistance(i);
            self.torques[i - 1] += elastic + viscous;
            self.torques[i] -= elastic + viscous;
            let natural = self.natural_per_m[i] * self.bend_m[i];
            if natural != 0.0 {
                let mean = (own + other) * (0.5 * natural);
                let half = near.cross(&far) * (natural / (1.0 + c));
                self.torques[i - 1] += (natural_torque(&near, &far, &mean) + own.cross(&half)) * stiffness;
                self.torques[i] += (other.cross(&half) - natural_torque(&far, &near, &mean)) * stiffness;
            }
            let (second, second_other) = (near.cross(&own), far.cross(&other));
            let aligned = own.dot(&other) + second.dot(&second_other);
            let untwisting = (own.cross(&other) + second.cross(&second_other)) / (1.0 + c)
                - near.cross(&far) * (aligned / (1.0 + c).powi(2));
            self.torques[i - 1] += untwisting * self.twist;
            self.torques[i] -= untwisting * self.twist;
        }
    }

    /// Viscous torque of a node on the segment before it, N m.
    fn resistance(&self, node: usize) -> Vector3<f64> {
        let rates = self.turning[node] - self.turning[node - 1];
        let along = (self.directors[node - 1] + self.directors[node]).normalize();
        let twisting = along * along.dot(&rates);
        ((rates - twisting) * self.bending[node] + twisting * self.twist) * self.retardation_s
    }

    /// Largest stable step of the explicit integrator, s, with a margin of two.
    ///
    /// ω² is at most the sum of the largest that stretching, shear and bending have alone: per segment stretching is
    /// EA/h (1, −1) on two nodes, shear κGA h (−1/h, 1/h, −1) on two nodes and a director, bending B (1, −1) on two
    /// directors, and every node and director has two neighbours. Twist turns sections about another axis and is
    /// slower than bending: C is less than B, and the inertia is twice as large.
    /// Symplectic Euler needs ω dt < 2 and, with damping, τ ω² dt < 2.
    pub fn stable_step_s(&self) -> f64 {
        let last = self.mass.len() - 1;
        let mut lightest = f64::INFINITY;
        for i in 0..=last {
            let segments = if i == 0 || i == last { 1.0 } else { 2.0 };
            lightest = lightest.min(self.mass[i] / segments);
        }
        let bends = self.bending.windows(2).map(|pair| pair[0] + pair[1]);
        let axial = 2.0 * self.axial / (self.rest_m * lightest);
        let shear = self.shear * (2.0 / (self.rest_m * lightest) + self.rest_m / self.inertia);
        let bending = 2.0 * bends.fold(0.0, f64::max) / self.inertia;
        let elastic = 2.0 / (axial + shear + bending).sqrt();
        let viscous = 2.0 / (self.retardation_s * (axial + shear + bending));
        0.5 * elastic.min(viscous)
    }

    /// Stored elastic energy, J.
    pub fn elastic_energy_j(&self) -> f64 {
        let mut energy = 0.0;
        for j in 0..self.directors.len() {
            let (strain, across) = self.strains(j, [j, j + 1].map(|node| self.square_bend(node)));
            let stiffer = 1.0 + 0.5 * self.stiffening * strain * strain;
            energy += 0.5 * self.axial * self.rest_m * strain * strain * stiffer;
            energy += 0.5 * self.shear * self.rest_m * across.norm_squared();
        }
        for i in 1..self.directors.len() {
            let [t0, t1] = [&self.directors[i - 1], &self.directors[i]];
            let c = t0.dot(t1);
            let square = self.square_bend(i);
            let [own, other] = [&self.sides[i - 1], &self.sides[i]];
            let aligned = own.dot(other) + t0.cross(own).dot(&t1.cross(other));
            energy += self.twist * (1.0 - aligned / (1.0 + c));
            let squeezed = self.squeezed(i, square);
            let squeezed = if squeezed > 0.0 {
                squeezed.ln_1p() / squeezed
            } else {
                1.0
            };
            energy += 0.5 * self.bending[i] * square * squeezed + 0.25 * self.quartic(i) * square * square;
        }
        energy
    }

    /// Kinetic energy, J.
    pub fn kinetic_energy_j(&self) -> f64 {
        let nodes = self.mass.iter().zip(&self.v).map(|(m, v)| m * v.norm_squared());
        let sections = self.turning.iter().zip(&self.directors);
        let sections = sections.map(|(w, d)| self.inertia * (w.norm_squared() + w.dot(d).powi(2)));
        0.5 * (nodes.sum::<f64>() + sections.sum::<f64>())
    }

    /// Sum of the nodes' momenta, kg m/s.
    pub fn momentum(&self) -> Vector3<f64> {
        let pairs = self.mass.iter().zip(&self.v);
        pairs.map(|(m, v)| v * *m).sum()
    }
}

/// t₀ × d(κb·k)/dt₀ with κb = 2 t₀ × t₁/(1 + t₀·t₁). Swapping the directors turns the sign.
fn natural_torque(t0: &Vector3<f64>, t1: &Vector3<f64>, natural: &Vector3<f64>) -> Vector3<f64> {
    let (c, bent) = (1.0 + t0.dot(t1), t0.cross(t1).dot(natural));
    let slope = t1.cross(natural) * (2.0 / c) - t1 * (2.0 * bent / (c * c));
    t0.cross(&slope)
}
