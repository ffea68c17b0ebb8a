//! The twin world: an independent rope model seen by simulated depth cameras, which plays reality.
