//! Execution of landings in a target world.

use glamx::DVec2;
use sms_landing::{LandingFailure, LandingRecording, LandingTask, QUADROTOR};
use sms_synth::LandingStructure;
use sms_target::{
    LandingExecution, LandingTargetOptions, SameEngineTarget, execute_landing, scene_from_truth,
};
use sms_wash::SphSettings;

/// Returns particles with twice the target's size of 3.5 cm.
fn options() -> LandingTargetOptions {
    LandingTargetOptions {
        planner_sph: SphSettings { spacing: 0.07, ..SphSettings::default() },
        recording: Some(LandingRecording { every_s: 0.05, particles: false }),
        enough: Some(1.0),
        ..LandingTargetOptions::default()
    }
}

/// From behind the base, the way to its middle does not cross the overhang. From the other side it crosses the whole
/// overhang. A load on the middle of the overhang tips the board.
#[test]
fn a_landing_over_the_base_succeeds_and_one_on_the_overhang_does_not() {
    let truth = LandingStructure::BoardOnStool.fixed();
    let planned = scene_from_truth(&truth).unwrap();
    let landing = truth.landing.as_ref().unwrap();
    let along = DVec2::from(landing.overhang_w);
    let base = truth.objects[0].aabb_w().center().truncate();
    let task = LandingTask::new((base - 2.0 * along).to_array()).resolve(&planned).unwrap();
    let nearest =
        |p: DVec2| task.surface().places().min_by(|a, b| a.distance(p).total_cmp(&b.distance(p))).unwrap();
    let fly = |p: DVec2| {
        let action = task.straight(nearest(p));
        execute_landing(&SameEngineTarget, &task, &action, &planned, &truth, &options()).unwrap()
    };
    let good = fly(base);
    assert!(good.outcome.is_success(), "{:?}", good.outcome.failure);
    assert!(good.second_opinion.as_ref().unwrap().is_success());
    assert_eq!(good.outcome.bodies.len(), truth.objects.len(), "every true body must stay");
    assert_eq!(good.matches.len(), truth.objects.len());
    assert!(good.outcome.trajectory.body(QUADROTOR).is_some() && good.engine.contains("same engine"));
    let dir = tempfile::tempdir().unwrap();
    good.save(dir.path()).unwrap();
    assert_eq!(LandingExecution::load(dir.path()).unwrap(), good);
    let bad = fly(DVec2::from(landing.end_w) - 0.2 * along);
    assert!(
        matches!(bad.outcome.failure, Some(LandingFailure::Moved { .. } | LandingFailure::Turned { .. })),
        "{:?}",
        bad.outcome.failure
    );
}
