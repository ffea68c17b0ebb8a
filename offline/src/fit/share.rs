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
