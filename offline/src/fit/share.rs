//! Which frames are fitted and which judge the fit.

/// Which frames of each demonstration count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FrameShare {
    /// Everything.
    All,
    /// What a model is fitted to where no other demonstration judges it.
    Fitted,
    /// What judges it then: the last part of a motion; of poses at rest every third, because they have no order in time,
    /// but often one by angle, and the last would be the most extreme.
    HeldOut,
}

/// Last share of a motion that is held out where no other demonstration is.
const HELD_OUT_SHARE: f64 = 0.3;
/// Of so many poses at rest one is held out.
const HELD_OUT_POSES: usize = 3;

impl FrameShare {
    /// Which part of a demonstration it is; nothing of the whole.
    pub(super) fn in_words(self) -> &'static str {
        match self {
            Self::All => "",
            Self::Fitted => " in the part of it that is fitted",
            Self::HeldOut => " in the part of it that is held out",
        }
    }

    /// What to do where too little of it was measured.
    pub(super) fn when_too_few(self) -> &'static str {
        match self {
            Self::HeldOut => "record more poses or for longer, or give another recording with --held-out",
            Self::All | Self::Fitted => {
                "check that the rope was seen where the clamp path and the length say it is, or record more"
            }
        }
    }

    /// Whether a frame out of `frames` counts, of poses at rest where `rests` says so.
    pub(super) fn contains(self, frame: usize, frames: usize, rests: bool) -> bool {
        let held_out = if rests {
            frame % HELD_OUT_POSES == 1
        } else {
            frame as f64 / frames as f64 >= 1.0 - HELD_OUT_SHARE
        };
        match self {
            Self::All => true,
            Self::Fitted => !held_out,
            Self::HeldOut => held_out,
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::demo::Demo;
    use crate::fit::{FrameShare, Problem, Resolution};
    use crate::model::Structure;
    use crate::sim::scene::MIN_CELLS_PER_DIAMETER;
    use std::path::Path;

    /// It was said that the clouds may show the rope elsewhere, where only the part to be held out was too short.
    #[test]
    fn too_few_offsets_are_said_of_the_part_that_has_them() {
        let mut demo =
            Demo::load(Path::new(env!("CARGO_MANIFEST_DIR")).join("demos/sample-rope/fit")).unwrap();
        match &mut demo.observations {
            crate::demo::Observations::Clouds(clouds) => clouds.truncate(2),
            crate::demo::Observations::Markers(_) => panic!("the sample shows clouds"),
        }
        let resolution = Resolution {
            cells: MIN_CELLS_PER_DIAMETER,
        };
        let problem = Problem::new(&[&demo], resolution)
            .unwrap()
            .of_share(FrameShare::HeldOut);
        let refusal = problem.residuals(&Structure::default(), &[14.0, 0.3]).err();
        let refusal = refusal.expect("two frames are too few").to_string();
        assert!(
            refusal.contains("in the part of it that is held out"),
            "{refusal}"
        );
        assert!(refusal.ends_with("with --held-out"), "{refusal}");
    }
}
