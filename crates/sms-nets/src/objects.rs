//! The user's requests: object names and boxes.

use crate::NetsError;
use crate::owlv2::PixelBox;
use sms_core::{InputError, LabelInfo};

/// Default queries: objects found on tables.
pub(crate) const HOUSEHOLD: [&str; 32] = [
    "mug",
    "cup",
    "glass",
    "bottle",
    "can",
    "bowl",
    "plate",
    "jar",
    "box",
    "carton",
    "book",
    "ball",
    "toy",
    "stuffed animal",
    "figurine",
    "tool",
    "pen",
    "scissors",
    "remote control",
    "phone",
    "keyboard",
    "mouse",
    "lamp",
    "vase",
    "candle",
    "fruit",
    "shoe",
    "bag",
    "basket",
    "tray",
    "stool",
    "plank",
];

/// Parses a list of queries such as `mug, toy duck`: blanks are trimmed, empty and repeated ones dropped.
///
/// # Errors
/// [`NetsError::Input`] if no query is left.
pub fn parse_objects(list: &str) -> Result<Vec<String>, NetsError> {
    let mut queries: Vec<String> = Vec::new();
    for query in list.split([',', ';', '\n']) {
        let query = query.split_whitespace().collect::<Vec<_>>().join(" ");
        if !query.is_empty() && !queries.contains(&query) {
            queries.push(query);
        }
    }
    if queries.is_empty() {
        let cure = "name the objects to find, such as --objects \"mug, toy duck, cue ball\"";
        return Err(InputError::new("no object is given", "--objects", cure).into());
    }
    Ok(queries)
}

/// Returns the queries with non-Latin letters: the network was trained on English.
pub fn foreign(queries: &[String]) -> Vec<&str> {
    let is_foreign = |c: char| c.is_alphabetic() && !('\0'..='\u{24f}').contains(&c);
    queries.iter().filter(|q| q.chars().any(is_foreign)).map(String::as_str).collect()
}

/// A box given by the user.
#[derive(Debug, Clone, PartialEq)]
pub struct NamedBox {
    /// Name of its content.
    pub name: String,
    /// The box in pixels of the first frame.
    pub bbox: PixelBox,
}

impl std::str::FromStr for NamedBox {
    type Err = InputError;

    /// Parses `mug=x0,y0,x1,y1`.
    fn from_str(text: &str) -> Result<Self, InputError> {
        let bad = |what: String| {
            InputError::new(what, "--box", "give --box \"mug=x0,y0,x1,y1\" in pixels of the first frame")
        };
        let (name, numbers) =
            text.rsplit_once('=').ok_or_else(|| bad(format!("`{text}` names no object")))?;
        let values: Vec<f64> = numbers
            .split(',')
            .map(|n| n.trim().parse::<f64>().ok().filter(|v| v.is_finite()))
            .collect::<Option<_>>()
            .ok_or_else(|| bad(format!("`{numbers}` are not numbers")))?;
        let &[x0, y0, x1, y1] = &values[..] else {
            return Err(bad(format!("`{numbers}` are {} numbers, not four", values.len())));
        };
        let name = name.trim();
        if name.is_empty() {
            return Err(bad(format!("`{text}` names no object")));
        }
        if x1 <= x0 || y1 <= y0 {
            return Err(bad(format!(
                "the box of `{name}` has no area: its right and lower edges come first"
            )));
        }
        Ok(Self { name: name.to_owned(), bbox: PixelBox { x0, y0, x1, y1 } })
    }
}

/// Returns labels with ids from 1 and names that are unique and usable as file names, for objects called
/// `descriptions`.
pub(crate) fn label_infos(descriptions: &[String]) -> Vec<LabelInfo> {
    let mut infos: Vec<LabelInfo> = Vec::new();
    for (i, description) in descriptions.iter().enumerate() {
        let mut base = String::new();
        for c in description.chars() {
            if c.is_ascii_alphanumeric() {
                base.push(c.to_ascii_lowercase());
            } else if !base.is_empty() && !base.ends_with('_') {
                base.push('_');
            }
        }
        base.truncate(48);
        let base = match base.trim_end_matches('_') {
            "" => "object".to_owned(),
            // Names of bodies that every scene may have besides its objects.
            reserved @ ("floor" | "environment" | "world") => format!("{reserved}_object"),
            base => base.to_owned(),
        };
        let is_free = |name: &String| infos.iter().all(|o| o.name != *name);
        let name = std::iter::once(base.clone())
            .chain((2..).map(|n| format!("{base}_{n}")))
            .find(is_free)
            .unwrap_or(base);
        infos.push(LabelInfo { id: i as u16 + 1, name, description: description.clone() });
    }
    infos
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_read_as_people_write_them() {
        assert_eq!(parse_objects(" mug,toy  duck ,, mug;cue ball").unwrap(), ["mug", "toy duck", "cue ball"]);
        assert!(matches!(parse_objects(" , "), Err(NetsError::Input(_))));
        let queries = vec!["tasse à café".to_owned(), "杯子".to_owned(), "кружка".to_owned()];
        assert_eq!(foreign(&queries), ["杯子", "кружка"]);
    }

    #[test]
    fn boxes_are_read_and_bad_ones_explained() {
        let named: NamedBox = "toy duck=10, 20,30.5,40".parse().unwrap();
        assert_eq!(named.name, "toy duck");
        assert_eq!(named.bbox, PixelBox { x0: 10.0, y0: 20.0, x1: 30.5, y1: 40.0 });
        for (text, word) in [
            ("10,20,30,40", "names no object"),
            ("mug=1,2,3", "3 numbers"),
            ("mug=1,2,x,4", "not numbers"),
            ("mug=1,2,NaN,4", "not numbers"),
            ("mug=5,2,3,4", "no area"),
            ("=1,2,3,4", "names no object"),
        ] {
            let message = text.parse::<NamedBox>().unwrap_err().to_string();
            assert!(message.contains(word), "{text}: {message}");
        }
    }

    #[test]
    fn names_are_unique_usable_and_keep_the_words() {
        let infos = label_infos(&["Toy duck!".into(), "toy duck".into(), "floor".into(), "杯子".into()]);
        let names: Vec<&str> = infos.iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["toy_duck", "toy_duck_2", "floor_object", "object"]);
        assert_eq!((infos[3].id, infos[3].description.as_str()), (4, "杯子"));
    }
}
