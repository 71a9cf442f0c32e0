//! Merges figures of seeds that ran separately into those of one run.

use crate::OptimiserBench;
use crate::bootstrap::{median, paired_difference};
use sms_core::metrics::Metrics;

/// The figures of [`crate::run_optimisers`] over all seeds, of those of one seed each in the order of `bench.seeds`.
pub fn merge_optimisers(bench: &OptimiserBench, each: &[Metrics]) -> Metrics {
    let column = |name: &str, budget: usize, key: &str| -> Vec<f64> {
        let key = format!("bench.optimisers.{name}.{budget}.{key}");
        each.iter().filter_map(|m| m.number(&key)).collect()
    };
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len().max(1) as f64;
    let mut metrics = Metrics::new();
    metrics.set("bench.optimisers.scenes", each.len());
    for (name, _) in &bench.entrants {
        for &budget in &bench.evaluations {
            let mut set = |key: &str, value: f64| {
                metrics.set(format!("bench.optimisers.{name}.{budget}.{key}"), value);
            };
            // A single seed has its value as the mean.
            let values = column(name, budget, "mean_m");
            set("mean_m", mean(&values));
            set("median_m", median(&values));
            for share in ["success_share", "blind_starts_share"] {
                set(share, mean(&column(name, budget, share)));
            }
            let others = column(&bench.baseline, budget, "mean_m");
            if *name != bench.baseline
                && let Some(d) = paired_difference(&values, &others)
            {
                set("difference_m", d.mean);
                set("difference_low_m", d.low);
                set("difference_high_m", d.high);
            }
        }
    }
    metrics
}

/// The figures of [`crate::run_plan_speed`] over all scenes, of those of one scene each: means.
pub fn merge_plan_speed(each: &[Metrics]) -> Metrics {
    let mut metrics = Metrics::new();
    for (key, _) in each.iter().flat_map(Metrics::iter) {
        let values: Vec<f64> = each.iter().filter_map(|m| m.number(key)).collect();
        metrics.set(key.clone(), values.iter().sum::<f64>() / values.len().max(1) as f64);
    }
    metrics.set("bench.plan.scenes", each.len());
    if let Some(seconds) = metrics.number("bench.plan.evaluation_s") {
        metrics.set("bench.plan.evaluations_per_s", 1.0 / seconds);
    }
    metrics
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{SceneFamily, run_optimisers};
    use sms_core::{Cancel, NoProgress};

    #[test]
    fn seeds_apart_make_the_figures_of_seeds_together() {
        let bench = |seeds: Vec<u64>| {
            let mut bench = OptimiserBench::new(seeds, SceneFamily::Open, vec![8]);
            bench.entrants.retain(|(name, _)| ["multi_start", "halving"].contains(&name.as_str()));
            bench
        };
        let run = |seeds| run_optimisers(&bench(seeds), &NoProgress, &Cancel::new()).unwrap();
        let all = vec![1001, 1002, 1003];
        let each: Vec<Metrics> = all.iter().map(|&s| run(vec![s])).collect();
        assert_eq!(merge_optimisers(&bench(all.clone()), &each), run(all));
    }

    #[test]
    fn speeds_are_means_and_the_rate_is_that_of_the_mean() {
        let of = |s: f64| {
            let mut m = Metrics::new();
            m.set("bench.plan.evaluation_s", s).set("bench.plan.evaluations_per_s", 1.0 / s);
            m
        };
        let merged = merge_plan_speed(&[of(0.1), of(0.3)]);
        assert_eq!(merged.number("bench.plan.evaluation_s"), Some(0.2));
        assert_eq!(merged.number("bench.plan.evaluations_per_s"), Some(5.0));
        assert_eq!(merged.number("bench.plan.scenes"), Some(2.0));
    }
}
