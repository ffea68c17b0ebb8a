//! What matters for the swing: how far each effect could move the reach at the size that the data still
//! allow, however invisible it was in the demonstration.

use crate::collect::Swinger;
use crate::effects;
use crate::fit::Resolution;
use crate::model::Structure;
use crate::sim::rope::RopeShape;
use crate::swing::SimulatedSwing;
use crate::tell::{Pieces, Tell};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::task::SwingTask;

/// Release points for which the reach is asked, (x, z) in m: over the paper's task. Near some releases a
/// rope folds, and the smallest change then moves its reach by centimetres; what counts is the middle of
/// three, so that one such release does not decide. The first serves alone for changes that are small there.
pub const RELEASES_M: [[f64; 2]; 3] = [[0.12, 0.1], [0.15, 0.1], [0.15, 0.15]];
/// Change of the reach that is small, mm: the simulation itself is known to be off by as much.
pub const SMALL_MM: f64 = 2.0;

/// The values of a parameter that the data still allow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Allowed {
    /// `young_pa`, `poisson` or `<effect>.<parameter>`.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Its effect in the registry; none for the two of elasticity.
    #[serde(skip)]
    pub effect: Option<usize>,
    /// Which of the effect's parameters; of the two of elasticity where there is no effect.
    #[serde(skip)]
    pub index: usize,
    /// Whether the model holds it.
    pub in_model: bool,
    /// Its value in the model, or where it vanishes.
    pub value: f64,
    /// 90 % interval within its physical range.
    pub interval: [f64; 2],
    /// Whether an end of the interval is that of the physical range: the data do not bound it there.
    pub bounded_by_range: bool,
}

impl Allowed {
    /// Half of the interval.
    pub fn half_width(&self) -> f64 {
        0.5 * (self.interval[1] - self.interval[0])
    }

    /// The interval of half width `half` about an estimate, within the physical range.
    pub fn within(mut self, estimate: f64, half: f64, range: [f64; 2]) -> Self {
        let ends = [estimate - half, estimate + half];
        self.bounded_by_range = ends[1] > range[1] || (ends[0] < range[0] && range[0] < self.value);
        self.interval = ends.map(|end| end.clamp(range[0], range[1]));
        self
    }
}

/// A parameter of an effect that the model lacks, which the data would probably not have shown at its smallest size of
/// interest: the effect cannot be excluded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Unseen {
    /// `<effect>.<parameter>`.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// The smallest size of interest.
    pub size: f64,
    /// Chance with which a test at 5 % would have shown that much.
    pub power: f64,
}

/// The effect in the name of one of its parameters.
fn effect_of(name: &str) -> Option<&str> {
    name.split('.').next()
}

/// What a parameter could do to the swing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwingRisk {
    /// The parameter and what the data allow.
    #[serde(flatten)]
    pub allowed: Allowed,
    /// Change of the reach per unit of the parameter over that interval, mm; none where no such swing could
    /// be simulated.
    pub slope_mm_per_unit: Option<f64>,
    /// Largest change of the reach within the interval, mm.
    pub at_most_mm: Option<f64>,
}

impl SwingRisk {
    /// What half of the interval is worth for the reach, mm: what more data could lower.
    pub fn open_mm(&self) -> Option<f64> {
        Some(self.slope_mm_per_unit? * self.allowed.half_width())
    }
}

/// What matters for the swing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwingRisks {
    /// Release points that the fitted rope can be released at, (x, z) in m.
    pub releases_m: Vec<[f64; 2]>,
    /// Its reach from each, m.
    pub reaches_m: Vec<f64>,
    /// One line per effect of the library, its parameter that matters most, and the two of elasticity;
    /// largest first.
    pub risks: Vec<SwingRisk>,
    /// What could be there and would probably not have been seen, in the order of the library.
    #[serde(default)]
    pub unseen: Vec<Unseen>,
    /// Why there are none.
    pub missing: Option<String>,
}

impl SwingRisks {
    /// Whether an effect that would probably not have been seen could move the reach by more than is small.
    pub fn matter_unseen(&self) -> bool {
        let large = |risk: &&SwingRisk| risk.at_most_mm.is_some_and(|mm| mm > SMALL_MM);
        let mut large = self.risks.iter().filter(large);
        large.any(|risk| {
            self.unseen
                .iter()
                .any(|one| effect_of(&one.name) == effect_of(&risk.allowed.name))
        })
    }

    /// Nothing is known, and why.
    pub fn missing(why: String) -> Self {
        Self {
            releases_m: Vec::new(),
            reaches_m: Vec::new(),
            risks: Vec::new(),
            unseen: Vec::new(),
            missing: Some(why),
        }
    }

    /// Swings the fitted rope with every parameter at the ends of what is allowed.
    pub fn of(
        rope: RopeShape,
        structure: &Structure,
        theta: &[f64],
        resolution: Resolution,
        allowed: Vec<Allowed>,
        progress: &dyn Tell,
    ) -> Self {
        let fitted = SimulatedSwing {
            rope,
            task: SwingTask::PAPER,
            structure: structure.clone(),
            effect_values: theta[2..].to_vec(),
            resolution,
        };
        let base = [theta[0].exp(), theta[1]];
        let tried: Vec<_> = RELEASES_M
            .par_iter()
            .map(|&release_m| (release_m, fitted.reach_m(base[0], base[1], release_m)))
            .collect();
        let reached =
            |(release_m, reach): &([f64; 2], Result<f64, _>)| Some((*release_m, *reach.as_ref().ok()?));
        let swings: Vec<([f64; 2], f64)> = tried.iter().filter_map(reached).collect();
        if let (true, Some((_, Err(error)))) = (swings.is_empty(), tried.first()) {
            return Self::missing(format!("this rope cannot make the swing: {error}"));
        }
        let pieces = Pieces::of(progress, "swings", allowed.len());
        let all: Vec<SwingRisk> = allowed
            .into_par_iter()
            .map(|allowed| pieces.ended(risk(&fitted, base, &swings, allowed)))
            .collect();
        Self {
            releases_m: swings.iter().map(|s| s.0).collect(),
            reaches_m: swings.iter().map(|s| s.1).collect(),
            risks: leading(all),
            unseen: Vec::new(),
            missing: None,
        }
    }
}

/// What a parameter does at the end of its interval that is farther from its value.
fn risk(fitted: &SimulatedSwing, base: [f64; 2], swings: &[([f64; 2], f64)], allowed: Allowed) -> SwingRisk {
    let far = |end: &f64| (end - allowed.value).abs();
    let [low, high] = allowed.interval;
    let end = if far(&low) > far(&high) { low } else { high };
    let only_seen = allowed
        .effect
        .is_some_and(|effect| effects::ALL[effect].only_seen);
    if only_seen || end == allowed.value {
        return SwingRisk {
            allowed,
            slope_mm_per_unit: Some(0.0),
            at_most_mm: Some(0.0),
        };
    }
    let (swing, [young_pa, poisson]) = with_value(fitted, base, &allowed, end);
    let moved_mm = |&(release_m, reach_m): &([f64; 2], f64)| -> Option<f64> {
        let there_m = swing.reach_m(young_pa, poisson, release_m).ok()?;
        Some(1e3 * (there_m - reach_m).abs())
    };
    let mut changes: Vec<f64> = swings.first().and_then(&moved_mm).into_iter().collect();
    if changes.first().is_none_or(|mm| *mm > SMALL_MM) {
        changes.extend(swings.iter().skip(1).filter_map(&moved_mm));
    }
    changes.sort_by(f64::total_cmp);
    let at_most_mm = changes.get(changes.len() / 2).copied();
    SwingRisk {
        slope_mm_per_unit: at_most_mm.map(|mm| mm / far(&end)),
        at_most_mm,
        allowed,
    }
}

/// The swing with one parameter at another value.
fn with_value(
    fitted: &SimulatedSwing,
    mut base: [f64; 2],
    allowed: &Allowed,
    value: f64,
) -> (SimulatedSwing, [f64; 2]) {
    let mut swing = fitted.clone();
    let Some(effect) = allowed.effect else {
        base[allowed.index] = value;
        return (swing, base);
    };
    let count = |&e: &usize| effects::ALL[e].parameters.len();
    let first = match swing.structure.effects.iter().position(|&e| e == effect) {
        Some(place) => swing.structure.effects[..place].iter().map(count).sum(),
        None => {
            swing.structure = swing.structure.with(effect);
            let first = swing.effect_values.len();
            swing.effect_values.extend(effects::ALL[effect].vanishing());
            first
        }
    };
    swing.effect_values[first + allowed.index] = value;
    (swing, base)
}

/// The parameter of each effect that matters most, largest first; what could not be simulated comes last.
fn leading(mut all: Vec<SwingRisk>) -> Vec<SwingRisk> {
    let size = |risk: &SwingRisk| risk.at_most_mm.unwrap_or(-1.0);
    all.sort_by(|a, b| size(b).total_cmp(&size(a)));
    let mut found: Vec<SwingRisk> = Vec::new();
    for risk in all {
        let effect = risk.allowed.effect;
        if effect.is_none() || found.iter().all(|one| one.allowed.effect != effect) {
            found.push(risk);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tell::Silent;

    fn allowed(id: &str, index: usize, half: f64) -> Allowed {
        let effect = effects::find(id).unwrap();
        let p = &effects::ALL[effect].parameters[index];
        Allowed {
            name: format!("{id}.{}", p.name),
            unit: p.unit.into(),
            effect: Some(effect),
            index,
            in_model: false,
            value: p.vanishes_at,
            interval: [0.0; 2],
            bounded_by_range: false,
        }
        .within(p.vanishes_at, half, [p.low, p.high])
    }

    #[test]
    fn an_interval_ends_where_physics_does_and_says_so() {
        let mass = allowed("tip_mass", 0, 0.05);
        assert_eq!((mass.interval, mass.bounded_by_range), ([0.0, 0.05], false));
        let unknown = allowed("tip_mass", 0, 5.0);
        assert_eq!((unknown.interval, unknown.bounded_by_range), ([0.0, 0.5], true));
        let tilt = allowed("tilted_gravity", 0, 1.0);
        assert_eq!((tilt.interval, tilt.bounded_by_range), ([-0.3, 0.3], true));
    }

    /// A mass at the tip moves the swing the more the more of it is allowed; a camera that is off never does.
    #[test]
    fn the_list_is_in_order_and_leaves_out_what_a_swing_cannot_feel() {
        let rope = RopeShape::of_density(0.25, 0.014, 1000.0);
        let structure = Structure::default();
        let list = |mass_kg: f64| {
            let allowed = vec![
                allowed("camera_offset", 0, 0.01),
                allowed("tip_mass", 0, mass_kg),
                allowed("air_drag", 0, 0.5),
            ];
            let theta = structure.start(0.9e6);
            SwingRisks::of(
                rope,
                &structure,
                &theta,
                Resolution { cells: 1.5 },
                allowed,
                &Silent,
            )
        };
        let (little, much) = (list(0.001), list(0.02));
        let of = |risks: &SwingRisks, id: &str| {
            risks
                .risks
                .iter()
                .find(|r| r.allowed.name.starts_with(id))
                .unwrap()
                .at_most_mm
                .unwrap()
        };
        assert!(of(&much, "tip_mass") > 3.0 * of(&little, "tip_mass"));
        assert_eq!(of(&much, "camera_offset"), 0.0);
        assert_eq!(much.risks[2].allowed.name, "camera_offset.shift_x_m");
        assert!(
            much.risks
                .windows(2)
                .all(|pair| pair[0].at_most_mm >= pair[1].at_most_mm)
        );
        assert_eq!(much.reaches_m.len(), 3);
        assert!(much.reaches_m.iter().all(|reach| (0.25..0.45).contains(reach)));
    }

    /// Another parameter of the same effect may be the one that matters most.
    #[test]
    fn what_would_not_have_been_seen_matters_where_it_can_move_the_reach() {
        let risk = |id: &str, index: usize, mm: Option<f64>| SwingRisk {
            allowed: allowed(id, index, 0.01),
            slope_mm_per_unit: None,
            at_most_mm: mm,
        };
        let found = |risks: Vec<SwingRisk>, unseen: &str| SwingRisks {
            risks,
            unseen: vec![Unseen {
                name: unseen.into(),
                unit: "1".into(),
                size: 0.1,
                power: 0.3,
            }],
            ..SwingRisks::missing(String::new())
        };
        let small = risk("air_drag", 0, Some(SMALL_MM));
        let large = risk("air_drag", 1, Some(1.5 * SMALL_MM));
        let of_drag = format!(
            "air_drag.{}",
            effects::ALL[effects::find("air_drag").unwrap()].parameters[0].name
        );
        assert!(!found(vec![small.clone()], &of_drag).matter_unseen());
        assert!(found(vec![small, large.clone()], &of_drag).matter_unseen());
        assert!(!found(vec![large], "tip_mass.mass_kg").matter_unseen());
        assert!(!found(vec![risk("air_drag", 0, None)], &of_drag).matter_unseen());
    }

    #[test]
    fn a_rope_that_cannot_make_the_swing_has_no_list_but_a_reason() {
        let short = RopeShape::of_density(0.1, 0.014, 1000.0);
        let structure = Structure::default();
        let found = SwingRisks::of(
            short,
            &structure,
            &structure.start(0.9e6),
            Resolution { cells: 1.5 },
            Vec::new(),
            &Silent,
        );
        assert!(found.missing.unwrap().contains("cannot make the swing"));
    }
}
