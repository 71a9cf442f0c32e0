//! Damaged replies: no panic, and no value that the reply does not contain. Values that survive the damage come out
//! unchanged; all others are reported as faults.

use rand::RngExt;
use sms_core::{Cancel, Interval, Seed, StageContext, Warnings};
use sms_materials::Estimate;
use sms_vlm::{
    Cache, Client, Question, Reading, Reply, Request, Sleep, Transport, TransportError, VlmConfig, ask,
    read_reply,
};
use std::sync::Arc;

const WHOLE: &str = r#"{"label_is_right": true, "label": "coffee mug", "description": "a blue mug for coffee",
 "material": "glazed ceramic", "properties": {
  "density_kg_m3": {"best": 2400, "low": 2200, "high": 2600},
  "fill_factor": {"best": 0.35, "low": 0.25, "high": 0.5},
  "friction": {"best": 0.45, "low": 0.3, "high": 0.55},
  "restitution": {"best": 0.5, "low": 0.3, "high": 0.6},
  "youngs_modulus_pa": {"best": 7e10, "low": 5e10, "high": 1e11},
  "poissons_ratio": {"best": 0.22, "low": 0.2, "high": 0.25}}}"#;

const FIELDS: [&str; 10] = [
    "label_is_right",
    "label",
    "description",
    "material",
    "density",
    "fill factor",
    "friction",
    "restitution",
    "Young's modulus",
    "Poisson's ratio",
];

fn value(e: &Estimate, field: &str) -> Option<Interval> {
    match field {
        "density" => e.density,
        "fill factor" => e.fill_factor,
        "friction" => e.friction,
        "restitution" => e.restitution,
        "Young's modulus" => e.youngs_modulus_pa,
        "Poisson's ratio" => e.poissons_ratio,
        _ => None,
    }
}

fn is_present(e: &Estimate, field: &str) -> bool {
    match field {
        "label_is_right" => e.label_is_right.is_some(),
        "label" => !e.label.is_empty(),
        "description" => !e.description.is_empty(),
        "material" => !e.material.is_empty(),
        _ => value(e, field).is_some(),
    }
}

/// Asserts that each field is either present and possible, or reported as a fault, and never both.
fn check(text: &str) -> Option<Reading> {
    let reading = match read_reply(text) {
        Ok(reading) => reading,
        Err(what) => {
            assert!(!what.is_empty());
            return None;
        }
    };
    for field in FIELDS {
        let is_fault = reading.faults.iter().any(|f| f.field == field && !f.what.is_empty());
        assert!(is_present(&reading.estimate, field) != is_fault, "{field} of {text}\n{reading:?}");
    }
    for (field, least, most) in [
        ("density", 10.0, 23_000.0),
        ("fill factor", 0.001, 1.0),
        ("friction", 0.005, 3.0),
        ("restitution", 0.0, 1.0),
        ("Young's modulus", 1e4, 1.3e12),
        ("Poisson's ratio", 0.0, 0.5),
    ] {
        let Some(i) = value(&reading.estimate, field) else { continue };
        let ordered = least <= i.low && i.low <= i.best && i.best <= i.high && i.high <= most;
        assert!(ordered, "{field} of {text}\n{i:?}");
    }
    Some(reading)
}

fn whole() -> Estimate {
    let reading = check(WHOLE).unwrap();
    assert_eq!(reading.faults, []);
    reading.estimate
}

#[test]
fn every_truncation_is_found_out() {
    let full = whole();
    let mut cut = 0;
    for end in (0..WHOLE.len()).filter(|&i| WHOLE.is_char_boundary(i)) {
        let reading = check(&WHOLE[..end]);
        if let Some(reading) = reading {
            cut += 1;
            assert!(!reading.faults.is_empty(), "a truncated answer is not whole: {end}");
            for field in FIELDS {
                let read = value(&reading.estimate, field);
                assert!(read.is_none() || read == value(&full, field), "{field} at {end}");
            }
        }
    }
    assert!(cut < 5, "an object that is not closed is seldom taken: {cut}");
}

/// Deletions, insertions, swaps and repeats of single characters and pieces, from a seed.
fn mangled(case: u64) -> String {
    let noise: Vec<char> = "{}[]\",:'\\-+.eE0159 \n\tuµ³%/*NaInf…“”\u{0}\u{feff}".chars().collect();
    let mut rng = Seed(0).derive_index("mangled", case).rng();
    let mut text: Vec<char> = WHOLE.chars().collect();
    for _ in 0..rng.random_range(1..=4) {
        let at = rng.random_range(0..text.len());
        let length = rng.random_range(1..=8usize).min(text.len() - at);
        match rng.random_range(0..6) {
            0 => drop(text.remove(at)),
            1 => drop(text.drain(at..at + length)),
            2 => text.insert(at, noise[rng.random_range(0..noise.len())]),
            3 => text[at] = noise[rng.random_range(0..noise.len())],
            4 => {
                let piece: Vec<char> = text[at..at + length].to_vec();
                let to = rng.random_range(0..text.len());
                text.splice(to..to, piece);
            }
            _ => {
                let other = rng.random_range(0..text.len());
                text.swap(at, other);
            }
        }
    }
    text.iter().collect()
}

#[test]
fn five_hundred_mangled_replies_end_as_checked_values_or_faults() {
    let (mut none, mut partial, mut full) = (0, 0, 0);
    for case in 0..500 {
        match check(&mangled(case)) {
            None => none += 1,
            Some(reading) if reading.faults.is_empty() => full += 1,
            Some(_) => partial += 1,
        }
    }
    assert!(none > 20 && partial > 20 && full > 20, "{none} none, {partial} partial, {full} full");
}

/// Answers object `n` with mangled reply `n`, each time.
struct Mangler;

impl Transport for Mangler {
    fn post(&self, request: &Request) -> Result<Reply, TransportError> {
        let body: serde_json::Value = serde_json::from_slice(&request.body).unwrap();
        let prompt = body["messages"][1]["content"][0]["text"].as_str().unwrap();
        let case = prompt.split("thing ").nth(1).and_then(|t| t.split('"').next()).unwrap();
        let text = mangled(case.parse().unwrap());
        let body = serde_json::json!({"choices": [{"message": {"content": text}}]});
        Ok(Reply { status: 200, retry_after: None, body: body.to_string().into_bytes() })
    }
}

/// The same through the whole conversation: every incomplete answer causes a warning that names the object.
#[test]
fn three_hundred_mangled_objects_are_answered_or_flagged_by_name() {
    let questions: Vec<Question> = (0..300)
        .map(|n| Question {
            name: format!("object_{n:03}"),
            annotation: format!("thing {n}"),
            is_surface: false,
            jpeg: vec![0xFF],
        })
        .collect();
    let config = VlmConfig { url: "http://nowhere/v1".into(), model: "m".into(), ..Default::default() };
    let client = Client::with(&config, None, Seed(0), Arc::new(Mangler), Arc::new(Sleep)).unwrap();
    let dir = tempfile::tempdir().unwrap();
    let warnings = Warnings::new();
    let cache = Cache::new(dir.path());
    let answers = ask(&questions, &client, &cache, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    assert_eq!(answers.given_up, None, "the server works");
    let warnings = warnings.snapshot();
    let mut requests = 0;
    for (n, (question, outcome)) in questions.iter().zip(&answers.outcomes).enumerate() {
        let named: Vec<&str> =
            warnings.iter().filter(|w| w.message.contains(&question.name)).map(|w| w.code.as_str()).collect();
        let (expected, rounds): (&[&str], u64) = match check(&mangled(n as u64)) {
            Some(reading) if reading.faults.is_empty() => (&[], 1),
            Some(reading) if reading.is_usable() => (&["vlm_partial"], 3),
            _ => (&["vlm_fallback"], 3),
        };
        assert_eq!(named, expected, "{n}: {outcome:?}");
        assert_eq!(outcome.answer().is_none(), expected == ["vlm_fallback"], "{n}");
        requests += rounds;
    }
    assert_eq!(answers.usage.requests, requests, "two repairs at most");
}

/// Replaces every value of the answer by every invalid one: that field is a fault, and no other.
#[test]
fn swapped_values_are_faults_of_their_field_alone() {
    let properties = [
        ("\"density_kg_m3\": {\"best\": 2400, \"low\": 2200, \"high\": 2600}", "density_kg_m3", "density"),
        ("\"fill_factor\": {\"best\": 0.35, \"low\": 0.25, \"high\": 0.5}", "fill_factor", "fill factor"),
        ("\"friction\": {\"best\": 0.45, \"low\": 0.3, \"high\": 0.55}", "friction", "friction"),
        ("\"restitution\": {\"best\": 0.5, \"low\": 0.3, \"high\": 0.6}", "restitution", "restitution"),
        (
            "\"youngs_modulus_pa\": {\"best\": 7e10, \"low\": 5e10, \"high\": 1e11}",
            "youngs_modulus_pa",
            "Young's modulus",
        ),
        (
            "\"poissons_ratio\": {\"best\": 0.22, \"low\": 0.2, \"high\": 0.25}",
            "poissons_ratio",
            "Poisson's ratio",
        ),
    ];
    let wrong = [
        "null",
        "true",
        "\"\"",
        "\"unknown\"",
        "NaN",
        "Infinity",
        "-Infinity",
        "1e400",
        "-1e400",
        "\"1e400\"",
        "-0.3",
        "\"-0.3\"",
        "[]",
        "{}",
        "{\"best\": null}",
        "{\"best\": {\"best\": {\"best\": 0.3}}}",
        "\"0.3 furlongs\"",
        "\"0.3.4\"",
        "\"١٢\"",
        "\"½\"",
        "[1, 2, 3, 4]",
        "{\"best\": 1e13, \"low\": 1, \"high\": 1e14}",
        "1e13",
        "{\"low\": 0.5, \"high\": 0.3}",
        "{\"best\": \"many\"}",
        "\"0.3 0.4\"",
        "\"> 0.3\"",
        "{\"best\": -1, \"low\": -2, \"high\": 3}",
        "\"0x1F\"",
        "\"1e\"",
        "\"--1\"",
        "{\"low\": 1}",
        "\"{}\"",
    ];
    let mut cases = 0;
    for (given, key, field) in properties {
        assert!(WHOLE.contains(given));
        for bad in wrong {
            let text = WHOLE.replace(given, &format!("\"{key}\": {bad}"));
            let reading = check(&text).unwrap_or_else(|| panic!("{bad}: the rest of the answer is whole"));
            let fields: Vec<&str> = reading.faults.iter().map(|f| f.field.as_str()).collect();
            assert_eq!(fields, [field], "{key}: {bad}\n{reading:?}");
            cases += 1;
        }
    }
    assert!(cases > 150, "{cases}");
}

/// Handwritten replies, after real models': the values and the faults.
#[test]
fn known_kinds_of_mischief() {
    let full = whole();
    let same = |text: &str| {
        let reading = check(text).unwrap_or_else(|| panic!("{text}"));
        assert_eq!((reading.faults.len(), &reading.estimate), (0, &full), "{text}");
    };
    let fault = |text: &str, field: &str| {
        let reading = check(text).unwrap_or_else(|| panic!("{text}"));
        assert_eq!(reading.faults.iter().map(|f| f.field.as_str()).collect::<Vec<_>>(), [field], "{text}");
    };
    let nothing = |text: &str| assert!(check(text).is_none(), "{text}");
    same(&format!("```json\n{WHOLE}\n```"));
    same(&format!("<think>{{\"density_kg_m3\": 7}}</think>\n{WHOLE}"));
    same(&format!("{{\"answer\": {WHOLE}}}"));
    same(&format!("[{WHOLE}]"));
    same(&serde_json::to_string(WHOLE).unwrap());
    same(&WHOLE.replace("}}", "},}"));
    same(&WHOLE.replace('"', "'"));
    same(
        &WHOLE
            .replace(['\n', ' '], "")
            .replace("coffeemug", "coffee mug")
            .replace("abluemugforcoffee", "a blue mug for coffee")
            .replace("glazedceramic", "glazed ceramic"),
    );
    same(&WHOLE.replace("true", "True"));
    same(&WHOLE.replace("2400", "2400.0").replace("7e10", "70000000000"));
    same(&WHOLE.replace("2400", "\"2,400 kg/m³\""));
    same(
        &WHOLE.replace("\"best\"", "\"value\"").replace("\"low\"", "\"min\"").replace("\"high\"", "\"max\""),
    );
    same(&WHOLE.replace(
        "{\"best\": 2400, \"low\": 2200, \"high\": 2600}",
        "{\"value\": 2.4, \"min\": 2.2, \"max\": 2.6, \"units\": \"g/cm^3\"}",
    ));
    same(&WHOLE.replace("0.5, \"low\": 0.3, \"high\": 0.6", "\"50%\", \"low\": \"30%\", \"high\": \"60%\""));
    same(&WHOLE.replace("\"properties\"", "\"physical_properties\""));
    same(&WHOLE.replace(
        "\"friction\"",
        "\"friction\": {\"best\": 0.45, \"low\": 0.3, \"high\": 0.55}, \"friction\"",
    ));
    same(&format!("{WHOLE}\n{WHOLE}"));
    fault(&WHOLE.replace("\"friction\"", "\"friction\": 0.9, \"friction\""), "friction");
    fault(&WHOLE.replace("2400", "2.4"), "density");
    fault(&WHOLE.replace("{\"best\": 2400, \"low\": 2200, \"high\": 2600}", "7.85"), "density");
    fault(&WHOLE.replace("{\"best\": 7e10, \"low\": 5e10, \"high\": 1e11}", "70"), "Young's modulus");
    fault(&WHOLE.replace("{\"best\": 0.45, \"low\": 0.3, \"high\": 0.55}", "\"45%\""), "friction");
    fault(
        &WHOLE.replace("{\"best\": 0.22, \"low\": 0.2, \"high\": 0.25}", "\"22 percent\""),
        "Poisson's ratio",
    );
    fault(&WHOLE.replace("\"high\": 0.25", "\"high\": 0.75"), "Poisson's ratio");
    fault(&WHOLE.replace("\"glazed ceramic\"", "[\"ceramic\", \"glaze\"]"), "material");
    fault(&WHOLE.replace("glazed ceramic", "N/A"), "material");
    fault(&WHOLE.replace("\"material\"", "\"mAtErIaL!\": \"wood\", \"material\""), "material");
    fault(&WHOLE.replace("coffee mug", "\\u0000\\u0001"), "label");
    for text in [
        "",
        " ",
        "{}",
        "[]",
        "null",
        "{",
        "}",
        "{{{{{{",
        "]]]]",
        "\"",
        "{\"\":{}}",
        "I cannot help with that.",
        "{\"error\": \"busy\"}",
        "\u{0}\u{0}\u{0}",
        "{\"a\": [[[[[[[[1]]]]]]]]}",
        "true",
        "2400",
        "{2400}",
        "{:}",
        "{\"density\"}",
        "𝟚𝟜𝟘𝟘",
        "{\"k\": \"\\uD800\"}",
    ] {
        nothing(text);
    }
    nothing(&"{\"a\":".repeat(5000));
    nothing(&"[".repeat(100_000));
    nothing(&"\\".repeat(10_000));
    // Long texts are cut, not refused.
    let long = check(&WHOLE.replace("a blue mug for coffee", &"blue ".repeat(2000))).unwrap();
    assert!(long.faults.is_empty() && long.estimate.description.chars().count() <= 601);
}
