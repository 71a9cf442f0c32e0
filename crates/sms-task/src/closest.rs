//! Closest approach of a moving point to a goal on the floor.

use glamx::DVec2;

/// Running minimum of the horizontal distance, exact for constant velocity between observations: within a step the
/// squared distance is quadratic in time and has a closed-form minimum. Without this, the objective would have a ripple
/// of half the travel in a step (1 mm at 0.8 m/s and 2.5 ms), and optimisers would stop at its local minima.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClosestApproach {
    goal_w: DVec2,
    last: Option<(f64, DVec2)>,
    distance: f64,
    time_s: f64,
}

impl ClosestApproach {
    /// Creates a minimum without observations.
    pub fn new(goal_w: DVec2) -> Self {
        Self { goal_w, last: None, distance: f64::INFINITY, time_s: 0.0 }
    }

    /// Adds the position at a time, which must not be before the last one.
    pub fn observe(&mut self, time_s: f64, p_w: DVec2) {
        let (distance, at) = match self.last {
            None => (p_w.distance(self.goal_w), time_s),
            Some((before_s, before)) => {
                let step = p_w - before;
                let length_squared = step.length_squared();
                let t = if length_squared > 0.0 {
                    ((self.goal_w - before).dot(step) / length_squared).clamp(0.0, 1.0)
                } else {
                    0.0
                };
                ((before + step * t).distance(self.goal_w), before_s + t * (time_s - before_s))
            }
        };
        if distance < self.distance {
            (self.distance, self.time_s) = (distance, at);
        }
        self.last = Some((time_s, p_w));
    }

    /// The smallest distance so far, metres; infinite before the first observation.
    pub fn distance(&self) -> f64 {
        self.distance
    }

    /// The time of the smallest distance, seconds.
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// Returns the smallest distance, metres, between the goal and a ray from the last position in a direction (of any
    /// length).
    pub(crate) fn distance_of_ray(&self, direction: DVec2) -> f64 {
        let Some((_, p_w)) = self.last else { return f64::INFINITY };
        let to_goal = self.goal_w - p_w;
        let along = to_goal.dot(direction.normalize_or_zero()).max(0.0);
        to_goal.distance(along * direction.normalize_or_zero())
    }

    /// The distance at the last observation, metres.
    pub fn current_distance(&self) -> f64 {
        self.last.map_or(f64::INFINITY, |(_, p)| p.distance(self.goal_w))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_fast_ball_between_two_steps_is_not_missed() {
        let mut closest = ClosestApproach::new(DVec2::new(0.5, 0.01));
        closest.observe(0.0, DVec2::new(0.4, 0.0));
        closest.observe(0.1, DVec2::new(0.6, 0.0));
        assert!((closest.distance() - 0.01).abs() < 1e-15);
        assert!((closest.time_s() - 0.05).abs() < 1e-15);
        assert!(closest.current_distance() > 0.1);
    }

    #[test]
    fn a_ray_towards_the_goal_comes_near_and_one_away_does_not() {
        let mut closest = ClosestApproach::new(DVec2::new(1.0, 0.1));
        closest.observe(0.0, DVec2::ZERO);
        assert!((closest.distance_of_ray(DVec2::X * 0.3) - 0.1).abs() < 1e-15);
        assert_eq!(closest.distance_of_ray(-DVec2::X), closest.distance());
    }

    #[test]
    fn a_resting_ball_keeps_its_distance() {
        let mut closest = ClosestApproach::new(DVec2::ZERO);
        for k in 0..3 {
            closest.observe(f64::from(k), DVec2::new(0.3, 0.4));
        }
        assert_eq!((closest.distance(), closest.time_s()), (0.5, 0.0));
    }

    proptest! {
        #[test]
        fn a_straight_path_gives_the_same_in_any_steps(
            y in -0.3..0.3f64, x0 in -1.0..-0.1f64, cuts in prop::collection::vec(0.0..1.0f64, 0..20),
        ) {
            // From (x0, y) to (1, y) past a goal at the origin, the distance is |y| for any sampling.
            let mut cuts = cuts;
            cuts.sort_by(f64::total_cmp);
            let mut closest = ClosestApproach::new(DVec2::ZERO);
            for t in std::iter::once(0.0).chain(cuts).chain([1.0]) {
                closest.observe(t, DVec2::new(x0 + t * (1.0 - x0), y));
            }
            prop_assert!((closest.distance() - y.abs()).abs() < 1e-12);
        }
    }
}
