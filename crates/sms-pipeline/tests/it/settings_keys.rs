//! The descriptions of the settings are the doc comments of their fields.

use sms_pipeline::settings::SECTIONS;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The types of the sections.
const TYPES: [(&str, &str); 13] = [
    ("recording", "RecordingSettings"),
    ("read", "ReadOptions"),
    ("frames", "LoadSettings"),
    ("poses", "PosesConfig"),
    ("masks", "GeometryConfig"),
    ("scan", "ScanConfig"),
    ("entities", "EntitiesConfig"),
    ("vlm", "VlmConfig"),
    ("plan", "PlanConfig"),
    ("landing", "LandingSettings"),
    ("flight", "FlightFiles"),
    ("robot", "RobotConfig"),
    ("evaluate", "EvaluateSettings"),
];

/// Units by the end of a key, with a word by which a description already states them.
const UNITS: [(&str, &str, &str); 6] = [
    ("_m2", "In square metres.", "m²"),
    ("_m", "In metres.", "etres"),
    ("_rad", "In radians.", "adians"),
    ("_deg", "In degrees.", "egrees"),
    ("_s", "In seconds.", "econds"),
    ("_px", "In pixels.", "ixels"),
];

/// A serialized field or variant.
#[derive(Debug, Clone)]
struct Item {
    key: String,
    doc: String,
    /// The type of a field; the data of a variant.
    kind: String,
}

/// The serialized structs and enums of the workspace, by name: the fields of each struct of a name, and the variants.
#[derive(Default)]
struct Types {
    structs: BTreeMap<String, Vec<Vec<Item>>>,
    enums: BTreeMap<String, Vec<Item>>,
}

fn sources(dir: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Converts the name of a variant as serde does.
fn snake_case(name: &str) -> String {
    let mut out = String::new();
    for (i, c) in name.char_indices() {
        if c.is_uppercase() && i > 0 {
            out.push('_');
        }
        out.extend(c.to_lowercase());
    }
    out
}

impl Types {
    fn read(crates: &Path) -> Self {
        let mut files = Vec::new();
        sources(crates, &mut files);
        files.sort();
        let mut types = Self::default();
        for file in files.iter().filter(|f| f.components().any(|c| c.as_os_str() == "src")) {
            types.add(&fs::read_to_string(file).unwrap());
        }
        types
    }

    /// Adds the types of a file in the form that rustfmt gives them.
    fn add(&mut self, text: &str) {
        let mut lines = text.lines();
        let mut attributes = String::new();
        while let Some(line) = lines.next() {
            let head = line.strip_prefix("pub ").and_then(|l| l.strip_suffix(" {"));
            let named = head.and_then(|h| h.split_once(' ')).filter(|_| attributes.contains("Deserialize"));
            match named {
                Some(("struct", name)) => {
                    let all = items(&mut lines, |code| {
                        let (key, kind) = code.strip_prefix("pub ").unwrap_or(code).split_once(": ")?;
                        Some((key.to_owned(), kind.to_owned()))
                    });
                    self.structs.entry(name.to_owned()).or_default().push(all);
                }
                Some(("enum", name)) => {
                    let is_snake = attributes.contains("rename_all = \"snake_case\"");
                    let all = items(&mut lines, |code| {
                        let end = code.find(['(', ' ', '{']).unwrap_or(code.len());
                        let (variant, data) = code.split_at(end);
                        let value = if is_snake { snake_case(variant) } else { variant.to_owned() };
                        Some((value, data.to_owned()))
                    });
                    self.enums.insert(name.to_owned(), all);
                }
                _ if line.starts_with("#[") => attributes.push_str(line),
                _ if line.starts_with("///") => {}
                _ => attributes.clear(),
            }
            if named.is_some() {
                attributes.clear();
            }
        }
    }

    /// Appends the lines of the keys of a struct.
    fn list(&self, path: &str, name: &str, out: &mut String) {
        let [fields] = &self.structs[name][..] else { panic!("two types are called {name}") };
        for Item { key, doc, kind } in fields {
            let key = format!("{path}.{key}");
            let kind = kind.strip_prefix("Option<").and_then(|k| k.strip_suffix('>')).unwrap_or(kind);
            let kind = kind.rsplit("::").next().unwrap();
            let mut about = readable(doc);
            if let Some(variants) = self.enums.get(kind) {
                let value = |Item { key, kind, .. }: &Item| {
                    if kind.is_empty() { format!("`{key}`") } else { format!("`{{ {key} = … }}`") }
                };
                let all: Vec<String> = variants.iter().map(value).collect();
                about.push_str(&format!(" One of {}.", all.join(", ")));
            }
            let of_key = UNITS.iter().find(|u| key.ends_with(u.0) && !key.contains("_per_"));
            if let Some((_, unit, _)) = of_key.filter(|u| !about.contains(u.2)) {
                about.push_str(&format!(" {unit}"));
            }
            out.push_str(&format!("{key}\t{about}\n"));
            if self.structs.contains_key(kind) {
                self.list(&key, kind, out);
            }
        }
    }
}

/// Reads the fields or variants up to the end of their type.
fn items<'a>(
    lines: &mut impl Iterator<Item = &'a str>,
    parse: impl Fn(&str) -> Option<(String, String)>,
) -> Vec<Item> {
    let (mut found, mut doc, mut attributes) = (Vec::new(), Vec::new(), String::new());
    for line in lines.take_while(|line| *line != "}") {
        // Deeper lines are the fields of a variant.
        let Some(code) = line.strip_prefix("    ").filter(|code| !code.starts_with([' ', '}'])) else {
            continue;
        };
        if let Some(text) = code.strip_prefix("///") {
            doc.push(text.trim().to_owned());
        } else if code.starts_with("#[") {
            attributes.push_str(code);
        } else if let Some((key, kind)) = parse(code.trim_end_matches(',')) {
            if !attributes.contains("serde(skip)") {
                let renamed = attributes.split_once("rename = \"").and_then(|r| r.1.split_once('"'));
                let key = renamed.map_or(key, |r| r.0.to_owned());
                // The first paragraph.
                let first: Vec<&str> = doc.iter().map(String::as_str).take_while(|d| !d.is_empty()).collect();
                found.push(Item { key, doc: first.join(" "), kind });
            }
            doc.clear();
            attributes.clear();
        }
    }
    found
}

/// Converts a doc comment to plain text: links to items of the code are left out or become their names.
fn readable(doc: &str) -> String {
    let mut text = doc.to_owned();
    while let Some(at) = text.find(" ([`") {
        let end = at + text[at..].find(')').unwrap();
        text.replace_range(at..=end, "");
    }
    text.replace("[`", "`").replace("`]", "`")
}

#[test]
fn descriptions_are_the_doc_comments() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    assert!(TYPES.iter().map(|t| t.0).eq(SECTIONS.iter().map(|s| s.0)), "a section has no type here");
    let types = Types::read(package.parent().unwrap());
    let mut made = String::new();
    for (section, name) in TYPES {
        types.list(section, name, &mut made);
    }
    for line in made.lines() {
        let (key, about) = line.split_once('\t').unwrap();
        assert!(about.len() > 3 && about.ends_with('.') && !about.contains("::"), "{key}: {about}");
    }
    let file = package.join("src").join("settings").join("keys.txt");
    if std::env::var_os("SMS_WRITE_KEYS").is_some() {
        fs::write(&file, &made).unwrap();
    }
    let kept = fs::read_to_string(&file).unwrap();
    let differing = made.lines().zip(kept.lines()).find(|(made, kept)| made != kept);
    assert!(made == kept, "{differing:?}: run this test once with SMS_WRITE_KEYS=1");
}
