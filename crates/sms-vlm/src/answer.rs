//! Parsing of replies into validated estimates and their faults.

use crate::node::{NoObject, ReplyNode, objects};
use crate::property::EstimatedProperty;
use crate::quantity::{Quantity, interval, plain, quantity, shortened};
use sms_materials::Estimate;

/// A part of a reply that could not be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {what}")]
pub struct Fault {
    /// Name of the field in messages.
    pub field: String,
    /// The problem with it.
    pub what: String,
}

/// A parsed reply: values in range and in SI units, and the faults of the rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    /// The usable values.
    pub estimate: Estimate,
    /// The faults; empty for a complete answer.
    pub faults: Vec<Fault>,
}

impl Reading {
    /// Whether at least the material or one property is usable.
    pub fn is_usable(&self) -> bool {
        let e = &self.estimate;
        !e.material.is_empty()
            || [e.density, e.fill_factor, e.friction, e.restitution, e.youngs_modulus_pa, e.poissons_ratio]
                .iter()
                .any(Option::is_some)
    }
}

/// Parses a reply in any dialect, using the JSON object with most answers in it.
///
/// # Errors
/// The complaint to send to the model if the reply contains no such object.
pub fn read_reply(text: &str) -> Result<Reading, String> {
    Fields::of(text).map(Fields::reading)
}

/// Greatest depth of nesting searched.
const MAX_DEPTH: usize = 4;
/// Greatest number of characters of a description.
const DESCRIPTION_CHARS: usize = 600;
/// Greatest number of characters of a label and of a material.
const LABEL_CHARS: usize = 80;

/// A field with a word or a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Word {
    LabelIsRight,
    Label,
    Description,
    Material,
}

impl Word {
    const ALL: [Self; 4] = [Self::LabelIsRight, Self::Label, Self::Description, Self::Material];

    fn name(self) -> &'static str {
        match self {
            Self::LabelIsRight => "label_is_right",
            Self::Label => "label",
            Self::Description => "description",
            Self::Material => "material",
        }
    }

    fn of(key: &str) -> Option<Self> {
        Some(match key {
            "labelisright" | "labeliscorrect" | "labelcorrect" | "labelright" | "labelaccurate"
            | "labelmatches" | "annotationaccuracy" | "annotationaccurate" | "annotationcorrect"
            | "labelaccuracy" => Self::LabelIsRight,
            "label" | "objectlabel" | "objectname" | "name" | "identity" | "object" | "correctlabel" => {
                Self::Label
            }
            "description" | "generaldescription" | "objectdescription" => Self::Description,
            "material" | "mainmaterial" | "dominantmaterial" | "primarymaterial" | "materialclass"
            | "materialname" | "materialtype" => Self::Material,
            _ => return None,
        })
    }
}

/// The parts of the value of one property.
#[derive(Debug, Default)]
struct Parts {
    best: Option<(ReplyNode, Option<String>)>,
    low: Option<ReplyNode>,
    high: Option<ReplyNode>,
    unit: Option<ReplyNode>,
    is_repeated: bool,
}

/// The fields of a reply, in any dialect.
#[derive(Debug, Default)]
pub(crate) struct Fields {
    words: Vec<(Word, ReplyNode)>,
    repeated: Vec<Word>,
    parts: Vec<(EstimatedProperty, Parts)>,
}

#[derive(Debug, Clone, Copy)]
enum End {
    Best,
    Low,
    High,
    Unit,
}

impl Fields {
    /// Collects the fields of the JSON object with most answers.
    ///
    /// # Errors
    /// The complaint to send to the model if the reply contains no such object.
    pub(crate) fn of(text: &str) -> Result<Self, String> {
        const CUT_OFF: &str = "the JSON object in the reply is not closed: it was cut off";
        let found = objects(text).map_err(|e| match e {
            NoObject::Missing => "there is no JSON object in the reply".to_owned(),
            NoObject::CutOff => CUT_OFF.to_owned(),
        })?;
        let mut best: Option<Fields> = None;
        for map in &found.maps {
            let mut fields = Fields::default();
            fields.collect(map, 0);
            if best.as_ref().is_none_or(|b| fields.count() >= b.count()) {
                best = Some(fields);
            }
        }
        let nothing = if found.is_cut_off {
            CUT_OFF
        } else {
            "the JSON object in the reply has none of the keys asked for"
        };
        best.filter(|f| f.count() > 0).ok_or_else(|| nothing.to_owned())
    }

    fn count(&self) -> usize {
        self.words.len() + self.parts.len()
    }

    fn collect(&mut self, map: &[(String, ReplyNode)], depth: usize) {
        if depth > MAX_DEPTH {
            return;
        }
        for (key, node) in map {
            let name = plain(key);
            if let Some(word) = Word::of(&name) {
                match node {
                    ReplyNode::Map(inner) => self.collect_named(word, inner, depth),
                    _ => self.word(word, node),
                }
            } else if let Some((property, end, unit)) = property_of(&name) {
                self.part(property, end, unit, node);
            } else {
                match node {
                    ReplyNode::Map(inner) => self.collect(inner, depth + 1),
                    ReplyNode::List(items) => items.iter().for_each(|item| self.collect_item(item, depth)),
                    _ => {}
                }
            }
        }
    }

    /// `"material": {"name": "ceramic", "density": …}`.
    fn collect_named(&mut self, word: Word, inner: &[(String, ReplyNode)], depth: usize) {
        let mut rest = Vec::new();
        for (key, node) in inner {
            match plain(key).as_str() {
                "name" | "class" | "type" | "value" | "label" if !matches!(node, ReplyNode::Map(_)) => {
                    self.word(word, node);
                }
                _ => rest.push((key.clone(), node.clone())),
            }
        }
        self.collect(&rest, depth + 1);
    }

    /// `"properties": [{"name": "density", "value": 2400, "unit": "kg/m3"}, …]`.
    fn collect_item(&mut self, item: &ReplyNode, depth: usize) {
        let ReplyNode::Map(entries) = item else { return };
        let names = |key: &str| matches!(plain(key).as_str(), "name" | "property" | "key");
        let name = entries.iter().find_map(|(k, v)| match v {
            ReplyNode::Text(text) if names(k) => Some(text),
            _ => None,
        });
        match name.and_then(|n| property_of(&plain(n))) {
            Some((property, end, unit)) => {
                let rest = entries.iter().filter(|(k, _)| !names(k)).cloned().collect();
                self.part(property, end, unit, &ReplyNode::Map(rest));
            }
            None => self.collect(entries, depth + 1),
        }
    }

    fn word(&mut self, word: Word, node: &ReplyNode) {
        match self.words.iter().find(|(w, _)| *w == word) {
            Some((_, earlier)) if earlier == node => {}
            Some(_) => self.repeated.push(word),
            None => self.words.push((word, node.clone())),
        }
    }

    fn part(&mut self, property: EstimatedProperty, end: End, unit: Option<String>, node: &ReplyNode) {
        if !self.parts.iter().any(|(p, _)| *p == property) {
            self.parts.push((property, Parts::default()));
        }
        let Some((_, parts)) = self.parts.iter_mut().find(|(p, _)| *p == property) else { return };
        let slot = match end {
            End::Best => {
                let earlier = parts.best.replace((node.clone(), unit));
                parts.is_repeated |= earlier.is_some_and(|(e, _)| e != *node);
                return;
            }
            End::Low => &mut parts.low,
            End::High => &mut parts.high,
            End::Unit => &mut parts.unit,
        };
        parts.is_repeated |= slot.replace(node.clone()).is_some_and(|earlier| earlier != *node);
    }

    /// Returns the value of a word.
    fn node(&self, word: Word) -> Result<&ReplyNode, String> {
        match self.words.iter().find(|(w, _)| *w == word).map(|(_, node)| node) {
            _ if self.repeated.contains(&word) => Err("it is given twice, differently".to_owned()),
            None | Some(ReplyNode::Null) => Err("it is missing".to_owned()),
            Some(node) => Ok(node),
        }
    }

    /// Returns the text of a word on one line.
    ///
    /// # Errors
    /// The complaint to send to the model if there is no text, or it has no letter.
    pub(crate) fn text(&self, word: Word) -> Result<String, String> {
        self.node(word).and_then(text_of)
    }

    fn reading(self) -> Reading {
        let mut estimate = Estimate::default();
        let mut faults = Vec::new();
        let mut fault = |field: &str, what: String| faults.push(Fault { field: field.to_owned(), what });
        for word in Word::ALL {
            if let Err(what) = self.node(word).and_then(|node| set_word(&mut estimate, word, node)) {
                fault(word.name(), what);
            }
        }
        for property in EstimatedProperty::ALL {
            let parts = self.parts.iter().find(|(p, _)| *p == property).map(|(_, parts)| parts);
            let read = parts.ok_or_else(|| "it is missing".to_owned()).and_then(|parts| {
                let q = parts.quantity(property)?;
                interval(property, q)
            });
            let slot = match property {
                EstimatedProperty::Density => &mut estimate.density,
                EstimatedProperty::FillFactor => &mut estimate.fill_factor,
                EstimatedProperty::Friction => &mut estimate.friction,
                EstimatedProperty::Restitution => &mut estimate.restitution,
                EstimatedProperty::YoungsModulus => &mut estimate.youngs_modulus_pa,
                EstimatedProperty::PoissonsRatio => &mut estimate.poissons_ratio,
            };
            match read {
                Ok(value) => *slot = Some(value),
                Err(what) => fault(property.name(), what),
            }
        }
        Reading { estimate, faults }
    }
}

impl Parts {
    fn quantity(&self, p: EstimatedProperty) -> Result<Quantity, String> {
        if self.is_repeated {
            return Err("it is given twice, differently".to_owned());
        }
        let unit_of_key = self.best.as_ref().and_then(|(_, unit)| unit.as_deref());
        match (&self.best, &self.low, &self.high, &self.unit) {
            (Some((node, _)), None, None, None) => quantity(p, node, unit_of_key),
            (best, low, high, unit) => {
                let named = |name: &str, node: Option<&ReplyNode>| node.map(|n| (name.to_owned(), n.clone()));
                let entries = [
                    named("best", best.as_ref().map(|(n, _)| n)),
                    named("low", low.as_ref()),
                    named("high", high.as_ref()),
                    named("unit", unit.as_ref()),
                ];
                quantity(p, &ReplyNode::Map(entries.into_iter().flatten().collect()), unit_of_key)
            }
        }
    }
}

/// Parses a key: `density_kg_m3_low` is the low end of the density, in kg/m³.
fn property_of(key: &str) -> Option<(EstimatedProperty, End, Option<String>)> {
    for property in EstimatedProperty::ALL {
        let Some(rest) = property.stems().iter().find_map(|stem| key.strip_prefix(stem)) else { continue };
        for (suffixes, end) in [
            (&["lowerbound", "minimum", "lower", "low", "min"][..], End::Low),
            (&["upperbound", "maximum", "upper", "high", "max"], End::High),
            (&["units", "unit"], End::Unit),
            (&["bestestimate", "estimate", "best", "value", "mean", "nominal", "typical", ""], End::Best),
        ] {
            let Some(rest) = suffixes.iter().find_map(|s| rest.strip_suffix(s)) else { continue };
            let unit = match rest {
                "" | "coefficient" | "static" | "kinetic" | "dynamic" | "of" | "s" => None,
                unit if crate::quantity::is_unit(property, unit) => Some(unit.to_owned()),
                _ => return None,
            };
            return Some((property, end, unit));
        }
    }
    None
}

fn set_word(estimate: &mut Estimate, word: Word, node: &ReplyNode) -> Result<(), String> {
    if word == Word::LabelIsRight {
        estimate.label_is_right = Some(match node {
            ReplyNode::Bool(b) => *b,
            ReplyNode::Text(text) => match plain(text).as_str() {
                "true" | "yes" | "correct" | "accurate" | "right" => true,
                "false" | "no" | "incorrect" | "inaccurate" | "wrong" => false,
                _ => return Err(format!("`{}` is neither true nor false", shortened(text, 30))),
            },
            other => return Err(format!("it is {} where true or false is needed", other.kind())),
        });
        return Ok(());
    }
    let text = text_of(node)?;
    match word {
        Word::Description => estimate.description = shortened(&text, DESCRIPTION_CHARS),
        Word::Material => {
            let none = ["unknown", "na", "none", "unclear", "unspecified", "indiscernible", "various"];
            if none.contains(&plain(&text).as_str()) {
                return Err("name the likeliest material".to_owned());
            }
            estimate.material = shortened(&text, LABEL_CHARS);
        }
        _ => estimate.label = shortened(&text, LABEL_CHARS),
    }
    Ok(())
}

/// Returns a text on one line.
fn text_of(node: &ReplyNode) -> Result<String, String> {
    let ReplyNode::Text(text) = node else {
        return Err(format!("it is {} where text is needed", node.kind()));
    };
    let text: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.chars().any(char::is_alphabetic) { Ok(text) } else { Err("it is empty".to_owned()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Interval;

    const WHOLE: &str = r#"{"label_is_right": true, "label": "coffee mug", "description": "a blue mug",
        "material": "glazed ceramic", "properties": {
        "density_kg_m3": {"best": 2400, "low": 2200, "high": 2600}, "fill_factor": {"best": 0.35, "low": 0.25, "high": 0.5},
        "friction": {"best": 0.4, "low": 0.3, "high": 0.5}, "restitution": {"best": 0.5, "low": 0.3, "high": 0.6},
        "youngs_modulus_pa": {"best": 7e10, "low": 5e10, "high": 1e11}, "poissons_ratio": {"best": 0.22, "low": 0.2, "high": 0.25}}}"#;

    fn faults(text: &str) -> Vec<String> {
        read_reply(text).unwrap().faults.iter().map(|f| f.field.clone()).collect()
    }

    #[test]
    fn a_whole_answer_is_read() {
        let reading = read_reply(WHOLE).unwrap();
        assert_eq!(reading.faults, []);
        let e = reading.estimate;
        assert_eq!(
            (e.label_is_right, e.label.as_str(), e.material.as_str()),
            (Some(true), "coffee mug", "glazed ceramic")
        );
        assert_eq!(e.density, Some(Interval::new(2400.0, 2200.0, 2600.0)));
        assert_eq!(e.youngs_modulus_pa, Some(Interval::new(7e10, 5e10, 1e11)));
    }

    #[test]
    fn other_shapes_of_the_same_answer_are_the_same() {
        let whole = read_reply(WHOLE).unwrap();
        let flat = r#"Here you are: {"label_is_right": "yes", "label": "coffee mug", "description": "a blue mug",
            "material": "glazed ceramic", "density_kg_m3": 2400, "density_kg_m3_low": 2200, "density_kg_m3_high": 2600,
            "fill_factor": 0.35, "fill_factor_low": "25 %", "fill_factor_high": 0.5, "friction": 0.4, "friction_low": 0.3,
            "friction_high": 0.5, "restitution": 0.5, "restitution_low": 0.3, "restitution_high": 0.6,
            "youngs_modulus_pa": 7e10, "youngs_modulus_pa_low": 5e10, "youngs_modulus_pa_high": 1e11,
            "poissons_ratio": 0.22, "poissons_ratio_low": 0.2, "poissons_ratio_high": 0.25}"#;
        assert_eq!(read_reply(flat).unwrap(), whole);
        let paper = r#"{"Annotation Accuracy": "accurate", "Object Label": "coffee mug", "General Description": "a blue mug",
            "Material": {"name": "glazed ceramic"}, "Density": "2200-2600 kg/m^3", "Fill Factor": [0.25, 0.35, 0.5],
            "Coefficient of Friction": {"value": 0.4, "min": 0.3, "max": 0.5},
            "Coefficient of Restitution": {"value": 0.5, "range": [0.3, 0.6]},
            "Young's Modulus (GPa)": {"value": 70, "low": 50, "high": 100},
            "Poisson's Ratio": {"best": "0.22", "low": "0.20", "high": "0.25"}}"#;
        assert_eq!(read_reply(paper).unwrap(), whole);
        let listed = r#"{"object": {"label": "coffee mug", "label_correct": true}, "description": "a blue mug",
            "material": "glazed ceramic", "properties": [
            {"name": "density", "value": 2.4, "low": 2.2, "high": 2.6, "unit": "g/cm3"},
            {"property": "fill factor", "best": 0.35, "low": 0.25, "high": 0.5},
            {"name": "friction coefficient", "best": 0.4, "low": 0.3, "high": 0.5},
            {"name": "restitution", "best": 0.5, "low": 0.3, "high": 0.6},
            {"name": "Young's modulus", "value": 70, "low": 50, "high": 100, "unit": "GPa"},
            {"name": "Poisson's ratio", "value": 0.22, "low": 0.2, "high": 0.25}]}"#;
        assert_eq!(read_reply(listed).unwrap(), whole);
    }

    #[test]
    fn the_object_that_answers_most_is_taken() {
        let text = format!("You asked for {{\"label\": \"…\"}}. {WHOLE} Done {{}}.");
        assert_eq!(read_reply(&text).unwrap(), read_reply(WHOLE).unwrap());
    }

    #[test]
    fn unusable_fields_are_reported_and_the_rest_is_kept() {
        for (from, to, field) in [
            ("2400", "\"2400 kg\"", "density"),
            ("2400", "2.4", "density"),
            ("{\"best\": 2400, \"low\": 2200, \"high\": 2600}", "null", "density"),
            ("{\"best\": 2400, \"low\": 2200, \"high\": 2600}", "{\"best\": null}", "density"),
            ("2400", "-2400", "density"),
            ("\"high\": 2600", "\"high\": 2000", "density"),
            ("0.35", "3.5", "fill factor"),
            ("\"best\": 0.4", "\"best\": \"40 %\"", "friction"),
            ("\"best\": 0.4", "\"best\": true", "friction"),
            ("\"best\": 0.5", "\"best\": 1.5", "restitution"),
            ("7e10", "70", "Young's modulus"),
            ("7e10", "1e400", "Young's modulus"),
            ("\"best\": 0.22", "\"best\": NaN", "Poisson's ratio"),
            ("\"poissons_ratio\"", "\"poisson_number\"", "Poisson's ratio"),
            ("glazed ceramic", "unknown", "material"),
            ("glazed ceramic", "", "material"),
            ("\"coffee mug\"", "17", "label"),
            ("true", "\"perhaps\"", "label_is_right"),
            ("\"friction\":", "\"friction\": 0.9, \"friction\":", "friction"),
        ] {
            assert!(WHOLE.contains(from), "{from}");
            let text = WHOLE.replacen(from, to, 1);
            assert_eq!(faults(&text), [field], "{from} → {to}");
        }
    }

    #[test]
    fn no_object_or_an_empty_one_says_so() {
        let half = &WHOLE[..WHOLE.len() / 2];
        for text in ["I see a mug of ceramic.", half, "{}", "{\"weather\": \"fine\"}"] {
            assert!(read_reply(text).is_err(), "{text}");
        }
    }
}
