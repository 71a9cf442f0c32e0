//! Why a scene's robust plan missed, in a sentence, as far as the figures tell.

use super::{BilliardsScene, Replaced, Row, Shot};

/// Objective up to which a shot counts as done, metres (the task's default).
pub(super) const DONE_M: f64 = 0.05;

/// What replaces what the planner knows, in words.
fn in_words(what: Replaced) -> &'static str {
    match what {
        Replaced::None => "nothing replaced",
        Replaced::Geometry => "true shapes",
        Replaced::Poses => "true poses",
        Replaced::Materials => "true materials",
        Replaced::Engine => "the planner's engine as target",
        Replaced::All => "everything true",
    }
}

/// The sentence; empty where the plan came off.
pub(super) fn cause(s: &BilliardsScene, engine: &str) -> String {
    if let Some(problem) = &s.problem {
        return format!("nothing planned: {problem}");
    }
    let Some(shot) = s.plans.get(&Row::Robust).and_then(|v| v.first()) else { return String::new() };
    let outcome = s.realised.get(engine).and_then(|of| of.get(&Row::Robust)?.first().copied());
    let Some(outcome) = outcome else { return String::new() };
    let realised = outcome.unwrap_or(s.idle_m);
    if realised <= DONE_M {
        return String::new();
    }
    if shot.action.is_none() {
        return "refused: no strike was found that the arm can make and that comes nearer to the goal".into();
    }
    if outcome.is_none() {
        let why = s.why_unfinished(engine, Row::Robust, 0).unwrap_or("the file does not say why");
        return format!("the engine could not finish the shot: {why}");
    }
    let promised = promised_m(shot);
    let told = if promised > DONE_M {
        // Of plans that are bad at once, half of the miss is no matter of the target.
        format!("predicted was bad already ({:.1} cm on average over disturbed worlds)", 1e2 * promised)
    } else {
        String::new()
    };
    let why = loss(s, engine, realised, promised)
        .unwrap_or_else(|| if told.is_empty() { without_ablation(s) } else { String::new() });
    [told, why].into_iter().filter(|t| !t.is_empty()).collect::<Vec<_>>().join("; ")
}

/// What the plan was predicted to do on average, metres.
pub(super) fn promised_m(shot: &Shot) -> f64 {
    shot.predicted_mean_m.unwrap_or(shot.predicted_m)
}

fn without_ablation(s: &BilliardsScene) -> String {
    if s.matched < s.objects {
        format!("{} of {} objects are not where the scan has any", s.objects - s.matched, s.objects)
    } else {
        "the target differs from what the plan allows for (--ablation tells in what)".into()
    }
}

/// What the ablation says of the robust plan; `None` where there is none for this engine.
fn loss(s: &BilliardsScene, engine: &str, realised: f64, promised: f64) -> Option<String> {
    let ablation = s.ablation.as_ref().filter(|a| a.judge == engine)?;
    let with = |what| ablation.realised_m(what, Row::Robust, s.idle_m);
    let singles = [Replaced::Geometry, Replaced::Poses, Replaced::Materials, Replaced::Engine];
    let mut tried: Vec<(f64, Replaced)> =
        singles.into_iter().filter_map(|what| Some((with(what)?, what))).collect();
    tried.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let &(best, what) = tried.first()?;
    let cm = |v: f64| format!("{:.1} cm", 1e2 * v);
    let chaotic = ablation.sensitivity_m.filter(|&v| v > 0.5 * (realised - promised).max(DONE_M));
    let touchy = chaotic.map(|v| format!("a millimetre elsewhere changes this shot by up to {}", cm(v)));
    // What a replacement must bring to be the cause: half of the loss, at least down to half of the miss.
    let loss = (realised - promised).max(0.5 * realised);
    let told = if realised - best >= 0.5 * loss {
        format!("{}: {} with {}", what.as_str(), cm(best), in_words(what))
    } else {
        match with(Replaced::All) {
            Some(all) if all <= DONE_M => {
                format!("several things together: {} with everything true", cm(all))
            }
            Some(all) => format!(
                "the search: {} even with everything true (best of one: {}, {})",
                cm(all),
                cm(best),
                in_words(what)
            ),
            None => String::new(),
        }
    };
    Some(match touchy {
        Some(touchy) => format!("chaotic: {touchy}; {told}"),
        None => told,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::MaterialsTold;
    use crate::billiards::{Ablated, Ablation, BilliardsGeometry, Drawing};
    use sms_core::Hash;
    use sms_synth::Layout;
    use sms_task::Action;
    use std::collections::BTreeMap;

    pub(in crate::billiards) fn scene(predicted_m: f64, realised_m: Option<f64>) -> BilliardsScene {
        let shot = Shot { action: Some(Action(vec![0.5, 0.1])), predicted_m, ..Shot::nothing(0.4) };
        let of = |v| BTreeMap::from([(Row::Robust, vec![v])]);
        BilliardsScene {
            key: Hash("k".into()),
            number: 3,
            layout: Layout::ALL[1],
            told: MaterialsTold::Class,
            geometry: BilliardsGeometry::Truth,
            idle_m: 0.4,
            objects: 4,
            matched: 4,
            strays: 0,
            problem: None,
            paper_problem: None,
            plans: BTreeMap::from([(Row::Robust, vec![shot])]),
            seconds: BTreeMap::new(),
            realised: BTreeMap::from([("judge".to_owned(), of(realised_m))]),
            unfinished: BTreeMap::new(),
            not_run: BTreeMap::new(),
            cpu_s: BTreeMap::new(),
            drawing: Drawing::default(),
            ablation: None,
        }
    }

    fn with_ablation(mut s: BilliardsScene, sensitivity_m: f64, values: [f64; 5]) -> BilliardsScene {
        let row = |v: f64| {
            let ablated = Ablated { predicted_m: vec![0.0], realised_m: vec![Some(v)], ..Ablated::default() };
            BTreeMap::from([(Row::Robust, ablated)])
        };
        let rows = Replaced::ALL[1..].iter().zip(values).map(|(&what, v)| (what, row(v))).collect();
        s.ablation =
            Some(Ablation { judge: "judge".into(), starts: 1, sensitivity_m: Some(sensitivity_m), rows });
        s
    }

    #[test]
    fn each_kind_of_failure_has_its_sentence() {
        let told = |s: &BilliardsScene| cause(s, "judge");
        assert_eq!(told(&scene(0.01, Some(0.04))), "");
        let mut lost = scene(0.01, None);
        assert!(told(&lost).ends_with("could not finish the shot: the file does not say why"));
        let why = BTreeMap::from([(0, "blew up".to_owned())]);
        lost.unfinished = BTreeMap::from([("judge".to_owned(), BTreeMap::from([(Row::Robust, why)]))]);
        assert!(told(&lost).ends_with("could not finish the shot: blew up"));
        assert!(told(&scene(0.2, Some(0.3))).contains("predicted was bad already (20.0 cm"));
        assert!(told(&scene(0.01, Some(0.3))).contains("--ablation"));
        let mut refused = scene(0.4, Some(0.4));
        refused.plans.insert(Row::Robust, vec![Shot::nothing(0.4)]);
        assert!(told(&refused).starts_with("refused"));

        let s = scene(0.01, Some(0.3));
        let of = |sensitivity, values| told(&with_ablation(s.clone(), sensitivity, values));
        assert_eq!(of(0.01, [0.3, 0.02, 0.25, 0.3, 0.0]), "poses: 2.0 cm with true poses");
        assert!(of(0.01, [0.3, 0.25, 0.25, 0.03, 0.0]).starts_with("engine: 3.0 cm"));
        assert!(of(0.01, [0.3, 0.28, 0.25, 0.3, 0.02]).starts_with("several things together: 2.0 cm"));
        assert!(of(0.01, [0.3, 0.28, 0.25, 0.3, 0.2]).starts_with("the search: 20.0 cm"));
        assert!(of(0.2, [0.3, 0.02, 0.25, 0.3, 0.0]).starts_with("chaotic: a millimetre elsewhere"));
        assert_eq!(cause(&s, "another"), "");
    }
}
