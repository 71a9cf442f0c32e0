//! Terms of a task's objective.

use crate::Selector;
use glamx::{DPose3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::InputError;
use std::path::Path;

/// Length equivalent to a rotation of one radian, metres: half the height of a mug (the path of its rim).
pub const METRES_PER_RADIAN: f64 = 0.1;

/// A place in the world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    deny_unknown_fields,
    expecting = "a place is { at_w = [x, y] }, { center_w = [x, y], radius_m = r } or { min_w = [x, y, z], max_w = [x, y, z] }"
)]
pub enum Region {
    /// A point on the floor, x and y in metres; heights are ignored.
    Point {
        /// The point.
        at_w: [f64; 2],
    },
    /// A disc on the floor; heights are ignored.
    Disc {
        /// Its centre, metres.
        center_w: [f64; 2],
        /// Its radius, metres.
        radius_m: f64,
    },
    /// A box along the world's axes.
    Box {
        /// Lowest corner, metres.
        min_w: [f64; 3],
        /// Highest corner, metres.
        max_w: [f64; 3],
    },
}

impl Region {
    /// Distance of a point to the region, metres; negative inside, as the depth below the surface.
    pub fn signed_distance(&self, p_w: DVec3) -> f64 {
        match self {
            Self::Point { at_w } => p_w.truncate().distance(DVec2::from_array(*at_w)),
            Self::Disc { center_w, radius_m } => {
                p_w.truncate().distance(DVec2::from_array(*center_w)) - radius_m
            }
            Self::Box { min_w, max_w } => {
                let (low, high) = (DVec3::from_array(*min_w), DVec3::from_array(*max_w));
                let out = (low - p_w).max(p_w - high);
                out.max(DVec3::ZERO).length() + out.max_element().min(0.0)
            }
        }
    }

    /// Its centre on the floor, world x and y.
    pub(crate) fn middle_w(&self) -> DVec2 {
        match self {
            Self::Point { at_w } => DVec2::from_array(*at_w),
            Self::Disc { center_w, .. } => DVec2::from_array(*center_w),
            Self::Box { min_w, max_w } => {
                0.5 * (DVec3::from_array(*min_w) + DVec3::from_array(*max_w)).truncate()
            }
        }
    }

    fn fault(&self) -> Option<&'static str> {
        let finite = |v: &[f64]| v.iter().all(|v| v.is_finite());
        match self {
            Self::Point { at_w } if !finite(at_w) => Some("`at_w` must be two finite numbers"),
            Self::Disc { center_w, radius_m }
                if !(finite(center_w) && *radius_m > 0.0 && *radius_m < 1e3) =>
            {
                Some("`center_w` must be two finite numbers and `radius_m` above 0")
            }
            Self::Box { min_w, max_w }
                if !finite(min_w) || !finite(max_w) || (0..3).any(|k| min_w[k] >= max_w[k]) =>
            {
                Some("`min_w` must lie below `max_w` in x, y and z")
            }
            _ => None,
        }
    }
}

/// The time at which a term is evaluated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum When {
    /// The best moment.
    #[default]
    Ever,
    /// The last moment, at the final position.
    End,
}

/// The bodies of a term.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "a body is \"others\", or one of { name = … }, { near = [x, y, z] }, { color = … }"
)]
pub enum TermBodies {
    /// All dynamic bodies except the struck one and those of other terms: `"others"`.
    Others(Others),
    /// One body.
    One(Selector),
}

impl TermBodies {
    /// Returns the selector of a single body.
    pub fn selector(&self) -> Option<&Selector> {
        match self {
            Self::One(selector) => Some(selector),
            Self::Others(_) => None,
        }
    }
}

/// The word `"others"`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Others {
    /// The only value.
    Others,
}

/// A term of the objective. Its value is 0 when satisfied and grows with the error, in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "term", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Term {
    /// The body's centre reaches a place. Value: its distance to the place.
    Reach {
        /// The body.
        body: TermBodies,
        /// The place.
        place: Region,
        /// The best moment, or the last.
        #[serde(default)]
        when: When,
        /// Factor in the sum.
        #[serde(default = "one")]
        weight: f64,
        /// Span of time that counts, seconds from the start of the sweep.
        #[serde(default = "always")]
        between_s: [f64; 2],
    },
    /// The body's centre stays out of a place. Value: the largest depth inside.
    Avoid {
        /// The bodies.
        body: TermBodies,
        /// The place; not a point.
        place: Region,
        /// Factor in the sum.
        #[serde(default = "one")]
        weight: f64,
        /// Span of time that counts, seconds from the start of the sweep.
        #[serde(default = "always")]
        between_s: [f64; 2],
    },
    /// The body stays in place. Value: the largest displacement of its centre plus its largest rotation times
    /// [`METRES_PER_RADIAN`].
    KeepStill {
        /// The bodies.
        body: TermBodies,
        /// Factor in the sum.
        #[serde(default = "one")]
        weight: f64,
        /// Span of time that counts, seconds from the start of the sweep.
        #[serde(default = "always")]
        between_s: [f64; 2],
    },
    /// The body falls over. Value: the missing tilt to `angle_rad`, times [`METRES_PER_RADIAN`].
    Topple {
        /// The body.
        body: TermBodies,
        /// Tilt that counts as toppled, radians.
        #[serde(default = "toppled")]
        angle_rad: f64,
        /// Factor in the sum.
        #[serde(default = "one")]
        weight: f64,
        /// Span of time that counts, seconds from the start of the sweep.
        #[serde(default = "always")]
        between_s: [f64; 2],
    },
}

fn one() -> f64 {
    1.0
}

fn toppled() -> f64 {
    1.0
}

fn always() -> [f64; 2] {
    [0.0, f64::MAX]
}

impl Term {
    /// The value of `term` in the file.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Reach { .. } => "reach",
            Self::Avoid { .. } => "avoid",
            Self::KeepStill { .. } => "keep-still",
            Self::Topple { .. } => "topple",
        }
    }

    /// The bodies, the weight, and the span of time that counts.
    fn common(&self) -> (&TermBodies, f64, [f64; 2]) {
        match self {
            Self::Reach { body, weight, between_s, .. }
            | Self::Avoid { body, weight, between_s, .. }
            | Self::KeepStill { body, weight, between_s }
            | Self::Topple { body, weight, between_s, .. } => (body, *weight, *between_s),
        }
    }

    /// The bodies of the term.
    pub fn bodies(&self) -> &TermBodies {
        self.common().0
    }

    /// The span of time that counts, seconds.
    pub(crate) fn between_s(&self) -> [f64; 2] {
        self.common().2
    }

    pub(crate) fn validate(
        &self,
        index: usize,
        horizon_s: f64,
        dt: f64,
        path: &Path,
    ) -> Result<(), InputError> {
        let fault = |why: &str| {
            let what = format!("`terms[{index}]` ({}) in this task file cannot be used: {why}", self.name());
            Err(InputError::new(what, path, "correct this term"))
        };
        let (bodies, weight, [from, to]) = self.common();
        if let Some(why) = bodies.selector().and_then(Selector::fault) {
            return fault(&format!("`body`: {why}"));
        }
        if !(weight > 0.0 && weight <= 1e6) {
            return fault("`weight` must be above 0 and at most 1e6");
        }
        if !(0.0 <= from && to - from >= 2.0 * dt && from < horizon_s) {
            return fault(
                "`between_s` must be [from, to] with from at least 0 and before the horizon's end, and two time steps or \
                 more between them",
            );
        }
        if is_indispensable(self) && matches!(bodies, TermBodies::Others(_)) {
            return fault("it needs the name of one body; \"others\" is for `avoid` and `keep-still`");
        }
        match self {
            Self::Reach { place, .. } | Self::Avoid { place, .. } => {
                if let Some(why) = place.fault() {
                    return fault(why);
                }
                if matches!((self, place), (Self::Avoid { .. }, Region::Point { .. })) {
                    return fault("a point has no interior to avoid; give a disc or a box");
                }
            }
            Self::Topple { angle_rad, .. } if !(*angle_rad > 0.0 && *angle_rad <= std::f64::consts::PI) => {
                return fault("`angle_rad` must be above 0 and at most π");
            }
            _ => {}
        }
        Ok(())
    }
}

/// Whether a term is meaningless without its body.
pub(crate) fn is_indispensable(term: &Term) -> bool {
    matches!(term, Term::Reach { .. } | Term::Topple { .. })
}

/// A term's value for one body during a motion.
#[derive(Debug, Clone)]
pub(crate) struct TermTracker<'a> {
    term: &'a Term,
    start: DPose3,
    last: Option<DVec3>,
    value: f64,
    moved: f64,
    turned: f64,
}

impl<'a> TermTracker<'a> {
    pub(crate) fn new(term: &'a Term, start: DPose3) -> Self {
        let value = match term {
            Term::Reach { .. } => f64::INFINITY,
            Term::Topple { angle_rad, .. } => METRES_PER_RADIAN * angle_rad,
            _ => 0.0,
        };
        Self { term, start, last: None, value, moved: 0.0, turned: 0.0 }
    }

    /// Observes the body's pose at `time_s`. The centre moves straight between observations.
    pub(crate) fn observe(&mut self, time_s: f64, x_wb: &DPose3) {
        let [from, to] = self.term.between_s();
        if time_s < from || time_s > to {
            self.last = None;
            return;
        }
        let p_w = x_wb.translation;
        match self.term {
            Term::Reach { place, when: When::Ever, .. } => {
                self.value = self.value.min(self.least_distance(place, p_w).max(0.0));
            }
            Term::Reach { place, when: When::End, .. } => self.value = place.signed_distance(p_w).max(0.0),
            Term::Avoid { place, .. } => {
                self.value = self.value.max(-self.least_distance(place, p_w).min(0.0));
            }
            Term::KeepStill { .. } => {
                self.moved = self.moved.max(p_w.distance(self.start.translation));
                self.turned = self.turned.max(x_wb.rotation.angle_between(self.start.rotation));
                self.value = self.moved + METRES_PER_RADIAN * self.turned;
            }
            Term::Topple { angle_rad, .. } => {
                let up_w = x_wb.rotation * (self.start.rotation.inverse() * DVec3::Z);
                let missing = METRES_PER_RADIAN * (angle_rad - up_w.angle_between(DVec3::Z));
                self.value = self.value.min(missing.max(0.0));
            }
        }
        self.last = Some(p_w);
    }

    /// Returns the smallest signed distance to a place since the last observation. The distance to a convex place is
    /// convex along a line, so a golden-section search finds the minimum.
    fn least_distance(&self, place: &Region, p_w: DVec3) -> f64 {
        let there = place.signed_distance(p_w);
        let Some(before) = self.last else { return there };
        let here = place.signed_distance(before);
        // Lower bound: the distance cannot be smaller than at the ends by more than the length of the line.
        if here.min(there) - before.distance(p_w) > self.value && matches!(self.term, Term::Reach { .. }) {
            return here.min(there);
        }
        let at = |t: f64| place.signed_distance(before.lerp(p_w, t));
        const GOLDEN: f64 = 0.618_033_988_749_894_8;
        let (mut low, mut high) = (0.0, 1.0);
        let (mut a, mut b) = (1.0 - GOLDEN, GOLDEN);
        let (mut at_a, mut at_b) = (at(a), at(b));
        for _ in 0..32 {
            if at_a < at_b {
                (high, b, at_b) = (b, a, at_a);
                a = high - GOLDEN * (high - low);
                at_a = at(a);
            } else {
                (low, a, at_a) = (a, b, at_b);
                b = low + GOLDEN * (high - low);
                at_b = at(b);
            }
        }
        here.min(there).min(at_a).min(at_b)
    }

    /// Records that the motion ended at `time_s` and everything rests: a later time span has the final pose.
    pub(crate) fn rest(&mut self, time_s: f64, x_wb: &DPose3) {
        let [from, _] = self.term.between_s();
        if from > time_s {
            self.observe(from, x_wb);
        }
    }

    /// The contribution to the objective, metres.
    pub(crate) fn cost(&self) -> f64 {
        self.term.common().1 * self.value
    }

    /// Whether the cost cannot become smaller.
    pub(crate) fn is_met(&self) -> bool {
        match self.term {
            Term::Reach { when: When::Ever, .. } | Term::Topple { .. } => self.value == 0.0,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;
    use proptest::prelude::*;

    fn at(x: f64, y: f64, z: f64) -> DPose3 {
        DPose3::from_translation(DVec3::new(x, y, z))
    }

    fn body() -> TermBodies {
        TermBodies::One(Selector::by_name("b"))
    }

    const BOX: Region = Region::Box { min_w: [0.0, 0.0, 0.0], max_w: [0.2, 0.1, 0.3] };

    fn reach(place: Region, when: When) -> Term {
        Term::Reach { body: body(), place, when, weight: 2.0, between_s: always() }
    }

    proptest! {
        /// The smallest distance to the line is independent of the sampling.
        #[test]
        fn reaching_does_not_depend_on_the_steps(
            y in -0.4..0.4f64, cuts in prop::collection::vec(0.0..1.0f64, 0..12),
        ) {
            let place = Region::Point { at_w: [0.0, 0.0] };
            let term = reach(place, When::Ever);
            let mut tracker = TermTracker::new(&term, at(-1.0, y, 0.0));
            let mut cuts = cuts;
            cuts.sort_by(f64::total_cmp);
            for t in std::iter::once(0.0).chain(cuts).chain([1.0]) {
                tracker.observe(t, &at(-1.0 + 2.0 * t, y, 0.0));
            }
            prop_assert!((tracker.cost() - 2.0 * y.abs()).abs() < 1e-6, "{} {}", tracker.cost(), y);
        }

        /// A body that passes through a box within one step is detected, with the depth that it reached.
        #[test]
        fn a_place_to_avoid_is_noticed_between_two_steps(depth in 0.005..0.045f64) {
            let term = Term::Avoid { body: body(), place: BOX, weight: 1.0, between_s: always() };
            let mut tracker = TermTracker::new(&term, at(-1.0, depth, 0.1));
            tracker.observe(0.0, &at(-1.0, depth, 0.1));
            tracker.observe(1.0, &at(1.0, depth, 0.1));
            prop_assert!((tracker.cost() - depth).abs() < 1e-6, "{}", tracker.cost());
        }

        #[test]
        fn distances_to_a_box_are_euclidean_outside_and_the_way_out_inside(
            x in -0.5..0.5f64, y in -0.5..0.5f64, z in -0.5..0.5f64,
        ) {
            let p = DVec3::new(x, y, z);
            let (low, high) = (DVec3::ZERO, DVec3::new(0.2, 0.1, 0.3));
            let nearest = p.clamp(low, high);
            let out = (p - low).min(high - p).min_element();
            let expected = if out > 0.0 { -out } else { p.distance(nearest) };
            prop_assert!((BOX.signed_distance(p) - expected).abs() < 1e-12);
        }
    }

    #[test]
    fn the_end_counts_the_final_position() {
        let term = reach(Region::Disc { center_w: [0.0, 0.0], radius_m: 0.1 }, When::End);
        let mut tracker = TermTracker::new(&term, at(1.0, 0.0, 0.0));
        for (t, x) in [(0.0, 1.0), (0.5, 0.0), (1.0, 0.4)] {
            tracker.observe(t, &at(x, 0.0, 0.0));
        }
        assert!((tracker.cost() - 0.6).abs() < 1e-12 && !tracker.is_met());
        tracker.observe(2.0, &at(0.05, 0.0, 0.0));
        assert_eq!(tracker.cost(), 0.0);
    }

    #[test]
    fn keep_still_counts_motion_and_rotation_within_its_time_span() {
        let term = Term::KeepStill { body: body(), weight: 1.0, between_s: [0.5, 2.0] };
        let mut tracker = TermTracker::new(&term, at(0.0, 0.0, 0.0));
        tracker.observe(0.1, &at(5.0, 0.0, 0.0));
        assert_eq!(tracker.cost(), 0.0, "before its time");
        tracker.observe(1.0, &DPose3::from_parts(DVec3::X * 0.02, DQuat::from_rotation_x(0.3)));
        tracker.observe(1.5, &at(0.01, 0.0, 0.0));
        assert!((tracker.cost() - (0.02 + 0.3 * METRES_PER_RADIAN)).abs() < 1e-12);
    }

    #[test]
    fn a_time_span_after_rest_sees_the_final_pose() {
        let place = Region::Point { at_w: [0.0, 0.0] };
        let term = Term::Reach { body: body(), place, when: When::Ever, weight: 1.0, between_s: [2.0, 3.0] };
        let mut tracker = TermTracker::new(&term, at(1.0, 0.0, 0.0));
        tracker.observe(0.5, &at(0.3, 0.0, 0.0));
        tracker.rest(0.5, &at(0.3, 0.0, 0.0));
        assert!((tracker.cost() - 0.3).abs() < 1e-12);
    }

    #[test]
    fn a_tilt_topples_and_a_spin_does_not() {
        let term = Term::Topple { body: body(), angle_rad: 1.0, weight: 1.0, between_s: always() };
        // The orientation of the body's own axes at the start is arbitrary.
        let start = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_y(0.7));
        let mut tracker = TermTracker::new(&term, start);
        let turned = |q: DQuat| DPose3::from_parts(DVec3::ZERO, q * start.rotation);
        tracker.observe(0.0, &turned(DQuat::from_rotation_z(2.0)));
        assert!((tracker.cost() - METRES_PER_RADIAN).abs() < 1e-9);
        tracker.observe(0.1, &turned(DQuat::from_rotation_x(0.4)));
        assert!((tracker.cost() - 0.6 * METRES_PER_RADIAN).abs() < 1e-9);
        tracker.observe(0.2, &turned(DQuat::from_rotation_x(1.2)));
        tracker.observe(0.3, &turned(DQuat::IDENTITY));
        assert!(tracker.is_met());
    }
}
