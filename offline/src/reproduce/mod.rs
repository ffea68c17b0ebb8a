//! The paper's own experiments, built as published and set beside this program's estimator.
//!
//! Data flows in the order of the files: the paper's demonstration as a [`scene`], what was seen of it
//! ([`data`]), its grid [`density`], the [`gradient`] estimator that descends on it by [`adam`], the
//! `pointnet` baseline, our own estimator ([`ours`]), all of them as a [`method`], how far two clouds differ
//! ([`chamfer`]), the two tables ([`sim2sim`], [`real2sim`]) and how they are printed ([`table`]). The tables of policies are in
//! `policies`. Beside them, what the paper does not report: how often our intervals hold the truth ([`coverage`]).
//!
//! Source: Kuroki et al. 2023, "GenORM: Generalizable One-shot Rope Manipulation with Parameter-Aware
//! Policy" (arXiv 2306.09872), sections 3.3, 4.2, 4.3 and appendix, and where it is silent the released
//! code (`Kuroki1931/UniDOM`), of which facts only were used.

pub mod adam;
pub mod chamfer;
pub mod coverage;
pub mod data;
pub mod density;
pub mod gradient;
pub mod method;
pub mod ours;
#[cfg(feature = "train")]
pub mod pointnet;
#[cfg(feature = "train")]
pub mod policies;
pub mod real2sim;
pub mod scene;
pub mod sim2sim;
pub mod table;
