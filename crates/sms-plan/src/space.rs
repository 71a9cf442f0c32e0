//! The box of actions, scaled to the unit box that optimisers search.

use sms_task::{Action, Parameter, ResolvedTask};

/// The box of the parameters and its promising part. "Unit" points are in [0, 1]ⁿ.
#[derive(Debug, Clone)]
pub struct Space {
    parameters: Vec<Parameter>,
    /// Ranges that receive as many screening points as the whole box, in unit coordinates; the whole box if the task
    /// has none.
    pub(crate) promising: Vec<[f64; 2]>,
    /// Unit points to try first.
    pub(crate) suggestions: Vec<Vec<f64>>,
}

impl Space {
    pub(crate) fn new(task: &ResolvedTask) -> Self {
        let parameters = task.parameters();
        let mut space =
            Self { promising: vec![[0.0, 1.0]; parameters.len()], suggestions: Vec::new(), parameters };
        if let Some(ranges) = task.direct_box() {
            let side = |i: usize| Action(ranges.iter().map(|r| r[i]).collect());
            let (low, high) = (space.unit(&side(0)), space.unit(&side(1)));
            space.promising = low.into_iter().zip(high).map(|(l, h)| [l, h]).collect();
        }
        space.suggestions = task.suggestions().iter().map(|a| space.unit(a)).collect();
        space
    }

    /// A box without a task, for tests.
    #[cfg(test)]
    pub(crate) fn of(parameters: Vec<Parameter>, promising: Vec<[f64; 2]>) -> Self {
        Self { parameters, promising, suggestions: Vec::new() }
    }

    /// Number of parameters.
    pub fn dimensions(&self) -> usize {
        self.parameters.len()
    }

    pub(crate) fn has_promising(&self) -> bool {
        self.promising.iter().any(|r| *r != [0.0, 1.0])
    }

    /// Step per coordinate for a search in the promising ranges or in the whole box.
    pub fn steps(&self, share: f64, promising: bool) -> Vec<f64> {
        self.promising.iter().map(|[l, h]| if promising { share * (h - l) } else { share }).collect()
    }

    /// Whether a unit point is in the promising ranges.
    pub(crate) fn is_promising(&self, x: &[f64]) -> bool {
        self.has_promising() && x.iter().zip(&self.promising).all(|(v, [l, h])| (l..=h).contains(&v))
    }

    /// Maps a unit point into the promising ranges.
    pub(crate) fn in_promising(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.promising).map(|(v, [l, h])| l + v * (h - l)).collect()
    }

    /// The unit point of an action, clamped to the box.
    pub fn unit(&self, action: &Action) -> Vec<f64> {
        let scale = |v: f64, p: &Parameter| if p.high > p.low { (v - p.low) / (p.high - p.low) } else { 0.5 };
        action.0.iter().zip(&self.parameters).map(|(&v, p)| scale(v, p).clamp(0.0, 1.0)).collect()
    }

    /// The action at a unit point, clamped to the box.
    pub fn action(&self, x: &[f64]) -> Action {
        let scale = |v: f64, p: &Parameter| (p.low + v * (p.high - p.low)).clamp(p.low, p.high);
        Action(x.iter().zip(&self.parameters).map(|(&v, p)| scale(v, p)).collect())
    }
}

/// Whether two unit points are within the steps of each other in every coordinate.
pub(crate) fn is_near(a: &[f64], b: &[f64], steps: &[f64]) -> bool {
    a.iter().zip(b).zip(steps).all(|((a, b), s)| (a - b).abs() <= *s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_points_and_actions_convert_both_ways_and_stay_in_bounds() {
        let parameter = |low: f64, high: f64| Parameter { name: "p".into(), unit: "m".into(), low, high };
        let space = Space::of(vec![parameter(0.2, 0.85), parameter(-1.0, 1.0), parameter(0.3, 0.3)], vec![]);
        let action = space.action(&[0.5, 0.25, 0.7]);
        assert_eq!(action.0[2], 0.3);
        let back = space.unit(&action);
        assert!((back[0] - 0.5).abs() < 1e-15 && (back[1] - 0.25).abs() < 1e-15);
        assert_eq!(space.action(&[1.0 + 1e-12, -1e-12, 0.0]).0, [0.85, -1.0, 0.3]);
    }
}
