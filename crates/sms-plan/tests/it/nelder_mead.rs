//! Nelder-Mead, compared with SciPy (table from `oracle/nelder_mead.py`), and its behaviour at bounds.

use proptest::prelude::*;
use serde_json::Value;
use sms_plan::{BoxBounds, LocalSearch, Minimum, NelderMead, SimplexSearch};

fn function(name: &str) -> fn(&[f64]) -> f64 {
    match name {
        "rosenbrock" => |x| {
            let mut total = 0.0;
            for pair in x.windows(2) {
                let (u, v) = (pair[1] - pair[0] * pair[0], 1.0 - pair[0]);
                total += 100.0 * (u * u) + v * v;
            }
            total
        },
        "himmelblau" => |x| {
            let (u, v) = (x[0] * x[0] + x[1] - 11.0, x[0] + x[1] * x[1] - 7.0);
            u * u + v * v
        },
        "quadratic" => |x| {
            let mut total = 0.0;
            for (i, v) in x.iter().enumerate() {
                let d = v - 0.25 * i as f64;
                total += (1.0 + i as f64) * (d * d);
            }
            total + 0.5 * (x[0] * x[1])
        },
        other => panic!("the table names a function that is not known here: {other}"),
    }
}

fn floats(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// SciPy's first simplex around a point: each coordinate 5 % larger in turn (0.00025 where it is zero).
fn scipy_simplex(x0: &[f64]) -> Vec<Vec<f64>> {
    let mut simplex = vec![x0.to_vec()];
    for k in 0..x0.len() {
        let mut x = x0.to_vec();
        x[k] = if x[k] != 0.0 { 1.05 * x[k] } else { 0.00025 };
        simplex.push(x);
    }
    simplex
}

/// Searches until the objective returns `None` or the search ends.
fn minimise(
    settings: &NelderMead,
    start: &[Vec<f64>],
    steps: &[f64],
    mut objective: impl FnMut(&[f64]) -> Option<f64>,
) -> Minimum {
    let mut search = LocalSearch::new(settings, start, steps, None);
    while let Some(x) = search.next_point() {
        let Some(f) = objective(x) else { break };
        search.tell(f);
    }
    search.minimum()
}

#[test]
fn visits_the_same_points_as_scipy() {
    let table: Value = serde_json::from_str(include_str!("../oracle/nelder_mead.json")).unwrap();
    let cases = table["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 9);
    for case in cases {
        let f = function(case["function"].as_str().unwrap());
        let bounds = case["bounds"].as_array().map(|sides| {
            let sides: Vec<Vec<f64>> = sides.iter().map(floats).collect();
            BoxBounds {
                low: sides.iter().map(|s| s[0]).collect(),
                high: sides.iter().map(|s| s[1]).collect(),
            }
        });
        let settings = NelderMead {
            adaptive: case["adaptive"].as_bool().unwrap(),
            // SciPy counts the evaluation of the first simplex as an iteration.
            max_iterations: case["maxiter"].as_u64().unwrap() as usize - 1,
            x_tolerance: 1e-4,
            f_tolerance: 1e-4,
            ..NelderMead::default()
        };
        let mut path: Vec<Vec<f64>> = Vec::new();
        let mut best = Vec::new();
        let mut search = SimplexSearch::new(&settings, scipy_simplex(&floats(&case["x0"])), bounds);
        while let Some(x) = search.next_point() {
            let value = f(x);
            path.push(x.iter().copied().chain([value]).collect());
            if search.tell(value) {
                best.push(search.best().1);
            }
        }
        let (x, objective) = search.best();
        let what = format!("{} from {} bounds {}", case["function"], case["x0"], case["bounds"]);
        for (ours, scipy) in path.iter().step_by(10).zip(case["path"].as_array().unwrap()) {
            assert_eq!(ours, &floats(scipy), "{what}");
        }
        assert_eq!(search.evaluations(), case["evaluations"].as_u64().unwrap() as usize, "{what}");
        assert_eq!(search.evaluations(), path.len(), "{what}");
        assert_eq!(search.iterations() + 1, case["nit"].as_u64().unwrap() as usize, "{what}");
        assert_eq!(x, floats(&case["x"]), "{what}");
        assert_eq!(objective, case["f"].as_f64().unwrap(), "{what}");
        let best: Vec<f64> = best.into_iter().step_by(10).collect();
        assert_eq!(best, floats(&case["best"]), "{what}");
    }
}

#[test]
fn a_restart_frees_a_simplex_that_collapsed_onto_a_bound() {
    // The slope along x collapses the simplex onto x = 0, where it can hardly search along y.
    let valley = |x: &[f64]| Some(5.0 * x[0] + (x[1] - 0.8).abs() + 0.2 * (x[0] - x[1] + 0.8).abs());
    let start = [vec![0.02, 0.1]];
    let settings = NelderMead { max_iterations: 400, ..NelderMead::default() };
    let once = minimise(&NelderMead { restarts: 0, ..settings }, &start, &[0.1, 0.1], valley);
    let thrice = minimise(&NelderMead { restarts: 3, ..settings }, &start, &[0.1, 0.1], valley);
    assert!(thrice.objective <= once.objective);
    assert!(thrice.objective < 1e-2, "{thrice:?}");
}

#[test]
fn a_stop_keeps_the_best_point_so_far() {
    let bowl = |x: &[f64]| (x[0] - 0.3) * (x[0] - 0.3) + (x[1] - 0.6) * (x[1] - 0.6);
    for budget in 1..40 {
        let (mut used, mut best) = (0, f64::INFINITY);
        let found = minimise(&NelderMead::default(), &[vec![0.9, 0.9]], &[0.1, 0.1], |x| {
            if used == budget {
                return None;
            }
            used += 1;
            best = best.min(bowl(x));
            Some(bowl(x))
        });
        assert_eq!(found.evaluations, used);
        assert_eq!(found.objective, best, "budget {budget}");
        assert_eq!(bowl(&found.x), found.objective);
    }
}

#[test]
fn values_that_are_not_numbers_are_avoided() {
    let holed = |x: &[f64]| Some(if x[0] > 0.5 { f64::NAN } else { (x[0] - 0.45).abs() + x[1] });
    let found = minimise(&NelderMead::default(), &[vec![0.2, 0.5]], &[0.2, 0.2], holed);
    assert!(found.objective < 0.02, "{found:?}");
}

proptest! {
    #[test]
    fn never_asks_outside_the_box_and_never_ends_worse_than_it_began(
        start in prop::collection::vec(0.0..=1.0f64, 1..5),
        pull in prop::collection::vec(-3.0..3.0f64, 4),
        step in 0.01..0.9f64,
        adaptive: bool,
    ) {
        let f = |x: &[f64]| x.iter().zip(&pull).map(|(v, p)| (v - p) * (v - p)).sum::<f64>();
        let mut outside = 0;
        let first = f(&start);
        let steps = vec![step; start.len()];
        let settings = NelderMead { adaptive, restarts: 2, ..NelderMead::default() };
        let found = minimise(&settings, std::slice::from_ref(&start), &steps, |x| {
            outside += x.iter().filter(|v| !(0.0..=1.0).contains(*v)).count();
            Some(f(x))
        });
        prop_assert_eq!(outside, 0);
        prop_assert!(found.objective <= first);
    }
}
