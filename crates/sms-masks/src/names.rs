//! Names of objects: unique in a scene and usable as file names.

/// Converts free text to a file name: ASCII letters and digits in lower case, everything else as single underscores;
/// never empty and at most 48 characters.
pub fn file_name(text: &str) -> String {
    let mut name = String::new();
    for c in text.chars() {
        if c.is_ascii_alphanumeric() {
            name.push(c.to_ascii_lowercase());
        } else if !name.is_empty() && !name.ends_with('_') {
            name.push('_');
        }
    }
    name.truncate(48);
    let name = name.trim_end_matches('_');
    if name.is_empty() { "object".to_owned() } else { name.to_owned() }
}

/// Names of bodies that a scene may have besides its objects.
const RESERVED: [&str; 3] = ["floor", "environment", "world"];

/// Appends `_2`, `_3`, … until the name is neither reserved nor among `taken`.
pub fn unique(name: String, taken: &[String]) -> String {
    let is_free = |n: &String| !taken.contains(n) && !RESERVED.contains(&n.as_str());
    if is_free(&name) {
        return name;
    }
    (2..).map(|n| format!("{name}_{n}")).find(is_free).unwrap_or(name)
}

/// Whether a source of masks gave this name: `object_` or `unknown_` with numbers.
pub fn is_automatic(name: &str) -> bool {
    let number = ["object_", "unknown_"].iter().find_map(|prefix| name.strip_prefix(prefix));
    number.is_some_and(|n| {
        n.starts_with(|c: char| c.is_ascii_digit()) && n.chars().all(|c| c.is_ascii_digit() || c == '_')
    })
}

/// Whether an object can have this name, which is also a file name.
pub fn is_usable(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 64
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-')
        && !name.starts_with('-')
        && !RESERVED.contains(&name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_text_becomes_a_usable_unique_name() {
        assert_eq!(file_name("Elmer's Glue (140 mm)"), "elmer_s_glue_140_mm");
        assert_eq!(file_name("Ω/.."), "object");
        assert_eq!(unique("cup".into(), &["cup".into(), "cup_2".into()]), "cup_3");
        assert_eq!(unique(file_name("Floor"), &[]), "floor_2");
        assert!(!is_usable("environment"));
        for name in ["object_03", "object_123", "object_04_2", "unknown_01"] {
            assert!(is_automatic(name) && is_usable(name), "{name}");
        }
        for name in ["object", "object_", "object_a", "object_3d_printed", "my_object_03", "mug_2"] {
            assert!(!is_automatic(name), "{name}");
        }
        assert!(is_usable(&file_name("../etc")) && !is_usable("../etc") && !is_usable(""));
    }
}
