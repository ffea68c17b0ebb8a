//! What kind of thing an effect changes, asked of the laws that it adds.

use super::problem::Problem;
use super::share::FrameShare;
use crate::model::Structure;
use crate::sim::start::Start;
use crate::sim::{Physics, Scene};

/// Whether every step of a rollout with an effect costs more.
pub(super) fn changes_material(effect: usize) -> bool {
    alone(effect).changes_material()
}

/// Whether an effect changes the shape at rest for good.
pub fn flows(effect: usize) -> bool {
    !alone(effect).flow_laws.is_empty()
}

/// Whether an effect turns the rope in its grip.
pub fn turns_in_grip(effect: usize) -> bool {
    alone(effect).grip_tilt.is_some()
}

/// Whether an effect changes when clamps let go.
fn opens_late(effect: usize) -> bool {
    alone_with(effect, largest).release_delay_s != 0.0
}

/// Whether an effect is an offset of clocks.
fn offsets_clocks(effect: usize) -> bool {
    alone_with(effect, largest).clock_offset_s() != 0.0
}

/// The physics of an effect that is there but does nothing.
fn alone(effect: usize) -> Physics<f64> {
    alone_with(effect, |structure| structure.start(1e6))
}

fn alone_with(effect: usize, theta: impl Fn(&Structure) -> Vec<f64>) -> Physics<f64> {
    let structure = Structure::default().with(effect);
    structure.physics(&theta(&structure), 0.0)
}

fn largest(structure: &Structure) -> Vec<f64> {
    structure.parameters().iter().map(|p| p.high).collect()
}

impl Problem<'_> {
    /// Why an effect cannot be told by these demonstrations, if it cannot.
    pub fn untold(&self, effect: usize) -> Option<&'static str> {
        let some_hang = self.scenes.iter().any(|scene| scene.start.hang().is_some());
        let starts = || self.scenes.iter().map(|scene| &scene.start);
        if some_hang && flows(effect) {
            Some("where a rope hangs that gives way depends on how it got there")
        } else if !some_hang && turns_in_grip(effect) {
            Some("a rope that lies straight was gripped as it lay")
        } else if opens_late(effect) && self.scenes.iter().all(Scene::holds_throughout) {
            Some(match self.frames {
                FrameShare::Fitted => {
                    "clamps hold in the part that is fitted; with another recording as --held-out all of this one is fitted"
                }
                FrameShare::All | FrameShare::HeldOut => "no clamp lets go in these demonstrations",
            })
        } else if offsets_clocks(effect)
            && starts().all(|start| matches!(start, Start::Moving(_) | Start::Poses(_)))
        {
            Some("a rope that is first seen in motion begins by the cameras' clock")
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench_diagnosis::experiment::MOTIONS;
    use crate::bench_diagnosis::reality::{Finer, Reality};
    use crate::demo::{Demo, Observations};
    use crate::effects;
    use crate::fit::Resolution;

    /// The gripper of the benchmark opens three frames before the end, of which one is fitted where its recording judges
    /// itself; of a single one that judges alone.
    #[test]
    fn a_late_release_is_told_only_where_clamps_let_go_in_what_counts() {
        let track = &Finer.rough_tracks(0.6e6, &[], &MOTIONS[..1]).unwrap()[0];
        let whole = MOTIONS[0].demo(track, 0.001, 1);
        let untold = |demo: &Demo, share: FrameShare, id: &str| {
            let problem = Problem::new(&[demo], Resolution { cells: 1.5 }).unwrap();
            problem.of_share(share).untold(effects::find(id).unwrap())
        };
        for share in [FrameShare::All, FrameShare::Fitted, FrameShare::HeldOut] {
            assert_eq!(untold(&whole, share, "release_delay"), None, "{share:?}");
        }
        let mut short = whole.clone();
        let times_s = whole.times_s();
        let last_s = times_s[times_s.len() - 3];
        match &mut short.observations {
            Observations::Markers(markers) => markers.retain(|marker| marker.t_s <= last_s),
            Observations::Clouds(_) => panic!("markers were asked for"),
        }
        assert_eq!(untold(&short, FrameShare::HeldOut, "release_delay"), None);
        let why = untold(&short, FrameShare::Fitted, "release_delay").unwrap();
        assert!(why.contains("--held-out"), "{why}");
        assert_eq!(untold(&short, FrameShare::Fitted, "gripper_lag"), None);
    }
}
