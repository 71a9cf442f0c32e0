//! Descriptions of the settings.

/// One key a line, with its description after a tab. `tests/it/settings_keys.rs` derives the lines from the doc comments
/// of the settings' fields, and compares.
const KEYS: &str = include_str!("keys.txt");

/// Returns every key (`scan.seeding.opacity`) and table (`scan.seeding`) with its description, section by section, in
/// the order of the fields.
pub fn descriptions() -> impl Iterator<Item = (&'static str, &'static str)> {
    KEYS.lines().filter_map(|line| line.split_once('\t'))
}

/// Returns the description of a key or table.
pub fn describe(key: &str) -> Option<&'static str> {
    descriptions().find(|d| d.0 == key).map(|d| d.1)
}

/// Returns the names of the keys and tables directly in a section or table, in order.
pub(super) fn names_in(table: &str) -> Vec<&'static str> {
    let below = |key: &'static str| key.strip_prefix(table)?.strip_prefix('.');
    descriptions().filter_map(|d| below(d.0)).filter(|name| !name.contains('.')).collect()
}
