//! The examples of the simulator's gradients do what they say.

#[path = "../../../offline/examples/aim_gripper.rs"]
mod aim_gripper;
#[path = "../../../offline/examples/fit_stiffness.rs"]
mod fit_stiffness;

#[test]
fn the_stiffness_is_found_by_gradient() {
    fit_stiffness::main().unwrap();
    let young_pa = fit_stiffness::fit().unwrap();
    assert!((young_pa / fit_stiffness::TRUE_PA - 1.0).abs() < 1e-6);
}

#[test]
fn the_tip_passes_through_the_point() {
    aim_gripper::main().unwrap();
    let miss_m = aim_gripper::aim().unwrap();
    assert!(miss_m < 1e-4, "{miss_m} m");
}
