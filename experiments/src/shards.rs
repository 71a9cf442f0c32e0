//! Parts of a benchmark that ran apart, put together again.
//!
//! A run with `--shard i/n` writes one file: the benchmark's name, the settings that its figures depend on, and the figures that it
//! found out about each item (a scene, a seed). [`merge_shards`] puts such files together, where their settings are the same;
//! means and tables are made of the items afterwards, by the code that makes them of a run in one piece.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use sms_core::metrics::Metrics;
use sms_core::{CoreError, Hash, Hasher, InputError, atomic, hash_serializable};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Version of the files; others are refused.
const VERSION: u32 = 1;
/// Suffix of the file names.
const ENDING: &str = ".shard.json";

/// A part of a benchmark.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    version: u32,
    /// Version of the program that wrote it.
    pub program: String,
    /// Build of the program: a hash of the executable; empty in older files or if it cannot be read.
    #[serde(default)]
    pub build: String,
    /// The benchmark: `robust`, `billiards`, …
    pub bench: String,
    /// Part and number of parts, from 1; 1 of 1 after a complete merge.
    pub part: (usize, usize),
    /// Settings that the figures depend on, besides the items.
    pub settings: Map<String, Value>,
    /// Hash of the settings.
    pub settings_hash: Hash,
    /// Results of each item, by its name.
    pub items: BTreeMap<String, Value>,
}

impl Shard {
    /// A part without items yet.
    pub fn new(bench: &str, part: (usize, usize), settings: Map<String, Value>) -> Self {
        Self {
            version: VERSION,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            build: this_build(),
            bench: bench.to_owned(),
            part,
            settings_hash: hash_serializable(&settings),
            settings,
            items: BTreeMap::new(),
        }
    }

    /// Adds the results of an item as figures.
    pub fn add(&mut self, item: &str, figures: &Metrics) {
        let map = figures.iter().map(|(k, v)| (k.clone(), v.clone())).collect();
        self.items.insert(item.to_owned(), Value::Object(map));
    }

    /// Adds the result of an item as a value, which [`Shard::values`] reads.
    ///
    /// # Errors
    /// Values that JSON has no text for.
    pub fn put<T: Serialize>(&mut self, item: &str, value: &T) -> Result<(), serde_json::Error> {
        self.items.insert(item.to_owned(), serde_json::to_value(value)?);
        Ok(())
    }

    /// Values added by [`Shard::put`], with the items' names, in their order.
    ///
    /// # Errors
    /// [`InputError`] where an item is something else.
    pub fn values<T: serde::de::DeserializeOwned>(&self) -> Result<Vec<(&str, T)>, InputError> {
        self.items
            .iter()
            .map(|(item, value)| {
                let value = serde_json::from_value(value.clone()).map_err(|e| {
                    InputError::new(
                        format!("a part of `bench {}` has no usable results of `{item}`: {e}", self.bench),
                        "merge",
                        "run the parts again with this version",
                    )
                })?;
                Ok((item.as_str(), value))
            })
            .collect()
    }

    /// The figures of an item; empty if it has none.
    pub fn figures(&self, item: &str) -> Metrics {
        let mut metrics = Metrics::new();
        if let Some(Value::Object(map)) = self.items.get(item) {
            for (key, value) in map {
                metrics.set(key.clone(), value.clone());
            }
        }
        metrics
    }

    /// A setting, read as the type it was written from.
    ///
    /// # Errors
    /// [`InputError`] if there is no such setting of this type.
    pub fn setting<T: serde::de::DeserializeOwned>(&self, name: &str) -> Result<T, InputError> {
        let value = self.settings.get(name).cloned().unwrap_or(Value::Null);
        serde_json::from_value(value).map_err(|e| {
            InputError::new(
                format!("a part of `sms-experiments {}` has no usable setting `{name}`: {e}", self.bench),
                "merge",
                "run the parts again with this version",
            )
        })
    }

    /// Path of a part's file for its results `out` (`part2.json`: `part2.shard.json`).
    pub fn path_beside(out: &Path) -> PathBuf {
        out.with_extension("shard.json")
    }

    /// Writes the file of a part into its folder of results, which parts may share.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save_in(&self, folder: &Path) -> Result<(), CoreError> {
        self.save(&folder.join(format!("part_{}_of_{}{ENDING}", self.part.0, self.part.1)))
    }

    /// Writes the file.
    ///
    /// # Errors
    /// [`CoreError::Write`].
    pub fn save(&self, path: &Path) -> Result<(), CoreError> {
        atomic::write_json(path, self)
    }

    fn load(path: &Path) -> Result<Self, CoreError> {
        let shard: Self = atomic::read_json(path)?;
        let bad = |what: &str| {
            let cure = "run that part again with this version";
            CoreError::from(InputError::new(what, path, cure))
        };
        if shard.version != VERSION {
            return Err(bad("this part was written by another version of the program"));
        }
        if shard.settings_hash != hash_serializable(&shard.settings) {
            return Err(bad("the settings in this file are not those that it was written with"));
        }
        Ok(shard)
    }
}

/// Splits `2/4`-like parts off a list: every n-th from the i-th, counted from 1.
pub fn part_of<T>(all: Vec<T>, (i, n): (usize, usize)) -> Vec<T> {
    all.into_iter().skip(i.saturating_sub(1)).step_by(n.max(1)).collect()
}

/// A hash of the running executable: code is all that figures depend on besides settings and items, and a version stays the same
/// through many changes of it.
fn this_build() -> String {
    let hashed = |path: &Path| Some(Hasher::new().file(path).ok()?.finish().0);
    // The former is the running program even where it has been replaced since (Linux).
    let itself = hashed(Path::new("/proc/self/exe"));
    itself.or_else(|| hashed(&std::env::current_exe().ok()?)).unwrap_or_default()
}

/// Parts that were put together.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// All items.
    pub whole: Shard,
    /// The parts that are missing, as `2/4`.
    pub missing: Vec<String>,
    /// Number of builds of the program that wrote the parts. The same code built on two machines gives two builds, so more
    /// than one is not an error.
    pub builds: usize,
}

/// Merges the parts in files and folders (all `*.shard.json` in them).
///
/// # Errors
/// [`InputError`] without parts, for parts of different benchmarks, programs or settings (which it names), or if two parts
/// hold different results for one item; [`CoreError`] for unreadable files.
pub fn merge_shards(paths: &[PathBuf]) -> Result<Merged, CoreError> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() {
            let entries = std::fs::read_dir(path).map_err(CoreError::read(path))?;
            let mut inside: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
            inside.retain(|p| p.to_string_lossy().ends_with(ENDING));
            inside.sort();
            if inside.is_empty() {
                let cure = "give folders that `sms-experiments … --shard` wrote to";
                return Err(
                    InputError::new(format!("no file `*{ENDING}` is in this folder"), path, cure).into()
                );
            }
            files.extend(inside);
        } else {
            files.push(path.clone());
        }
    }
    let mut whole: Option<(Shard, PathBuf)> = None;
    let mut parts: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    let mut builds = BTreeSet::new();
    for file in files {
        let shard = Shard::load(&file)?;
        parts.entry(shard.part.1).or_default().push(shard.part.0);
        builds.insert(shard.build.clone());
        match &mut whole {
            None => whole = Some((shard, file)),
            Some((whole, first)) => join(whole, first, shard, &file)?,
        }
    }
    let Some((mut whole, _)) = whole else {
        return Err(InputError::new("nothing to merge", "merge", "give folders or files of parts").into());
    };
    // Parts of the finest splitting; parts of a coarser one may fill its gaps, which only the items could show.
    let missing: Vec<String> = parts
        .iter()
        .flat_map(|(n, there)| (1..=*n).filter(|i| !there.contains(i)).map(move |i| format!("{i}/{n}")))
        .collect();
    if missing.is_empty() {
        whole.part = (1, 1);
    }
    Ok(Merged { whole, missing, builds: builds.len() })
}

fn join(whole: &mut Shard, first: &Path, shard: Shard, file: &Path) -> Result<(), CoreError> {
    let refuse = |what: String, cure: &str| Err(CoreError::from(InputError::new(what, file, cure)));
    let first = first.display();
    if shard.bench != whole.bench {
        let what =
            format!("a part of `bench {}`, while {first} is one of `bench {}`", shard.bench, whole.bench);
        return refuse(what, "merge parts of one benchmark");
    }
    if shard.program != whole.program {
        let what = format!("written by version {}, and {first} by {}", shard.program, whole.program);
        return refuse(what, "run all parts with one version");
    }
    if shard.settings_hash != whole.settings_hash {
        let keys: std::collections::BTreeSet<&String> =
            shard.settings.keys().chain(whole.settings.keys()).collect();
        let differ: Vec<String> = keys
            .into_iter()
            .filter(|k| shard.settings.get(*k) != whole.settings.get(*k))
            .map(|k| difference(k, whole.settings.get(k), shard.settings.get(k)))
            .collect();
        let what = format!("other settings than in {first}: {}", differ.join("; "));
        return refuse(what, "run all parts with the same settings");
    }
    for (item, value) in shard.items {
        match whole.items.get(&item) {
            Some(there) if *there != value => {
                let what = format!("`{item}` is in {first} or a part after it, too, with other results");
                return refuse(what, "give each part once");
            }
            _ => {
                whole.items.insert(item, value);
            }
        }
    }
    Ok(())
}

/// Which setting differs, down to the innermost keys of tables.
fn difference(name: &str, a: Option<&Value>, b: Option<&Value>) -> String {
    if let (Some(Value::Object(a)), Some(Value::Object(b))) = (a, b) {
        let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
        let inner: Vec<String> = keys
            .into_iter()
            .filter(|k| a.get(*k) != b.get(*k))
            .map(|k| difference(&format!("{name}.{k}"), a.get(k), b.get(k)))
            .collect();
        return inner.join("; ");
    }
    let text = |v: Option<&Value>| v.map_or_else(|| "nothing".to_owned(), Value::to_string);
    format!("`{name}` is {} and {}", text(a), text(b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn settings(worlds: usize, robust: f64) -> Map<String, Value> {
        let Value::Object(map) = json!({"worlds": worlds, "plan": {"robust": robust, "starts": 8}}) else {
            panic!("an object")
        };
        map
    }

    fn write(
        dir: &Path,
        part: (usize, usize),
        settings: Map<String, Value>,
        items: &[(&str, f64)],
    ) -> PathBuf {
        let mut shard = Shard::new("robust", part, settings);
        for (item, value) in items {
            let mut figures = Metrics::new();
            figures.set("bench.value", *value);
            shard.add(item, &figures);
        }
        let path = Shard::path_beside(&dir.join(format!("part{}.json", part.0)));
        shard.save(&path).unwrap();
        path
    }

    #[test]
    fn parts_make_the_whole_in_any_order_and_missing_ones_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let a = write(dir.path(), (1, 3), settings(4, 0.5), &[("1001", 0.1), ("1003", 0.3)]);
        let b = write(dir.path(), (2, 3), settings(4, 0.5), &[("1002", 0.2)]);
        let Merged { whole: one, missing, builds } = merge_shards(&[a.clone(), b.clone()]).unwrap();
        assert_eq!((&missing[..], builds), (&["3/3".to_owned()][..], 1));
        assert_eq!(merge_shards(&[b.clone(), a]).unwrap().whole.items, one.items);
        assert_eq!(one.items.keys().collect::<Vec<_>>(), ["1001", "1002", "1003"]);
        assert_eq!(one.figures("1002").number("bench.value"), Some(0.2));
        write(dir.path(), (3, 3), settings(4, 0.5), &[]);
        let Merged { whole, missing, .. } = merge_shards(&[dir.path().to_owned()]).unwrap();
        assert!(missing.is_empty() && whole.part == (1, 1));
        // A part from another build of the same version.
        let mut other = Shard::load(&b).unwrap();
        assert_eq!(other.build.len(), 32, "the test's own executable can be read");
        other.build = "before".into();
        other.save(&b).unwrap();
        assert_eq!(merge_shards(&[dir.path().to_owned()]).unwrap().builds, 2);
        assert_eq!(whole.setting::<usize>("worlds").unwrap(), 4);
        assert!(whole.setting::<usize>("nothing").unwrap_err().to_string().contains("nothing"));
        let parts: Vec<i32> =
            [1, 2, 3].into_iter().flat_map(|i| part_of((0..10).collect(), (i, 3))).collect();
        assert_eq!(parts, [0, 3, 6, 9, 1, 4, 7, 2, 5, 8]);
    }

    #[test]
    fn what_does_not_belong_together_is_refused_with_what_differs() {
        let dir = tempfile::tempdir().unwrap();
        let a = write(dir.path(), (1, 2), settings(4, 0.5), &[("1001", 0.1)]);
        let b = write(dir.path(), (2, 2), settings(4, 0.6), &[("1002", 0.2)]);
        let material_prior = |paths: &[PathBuf]| merge_shards(paths).unwrap_err().to_string();
        let message = material_prior(&[a.clone(), b.clone()]);
        assert!(message.contains("`plan.robust` is 0.5 and 0.6") && !message.contains("worlds"), "{message}");
        let other = dir.path().join("other");
        let c = write(&other, (1, 2), settings(4, 0.5), &[("1001", 0.7)]);
        assert!(material_prior(&[a.clone(), c]).contains("`1001`"));
        let empty = dir.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        assert!(material_prior(&[empty]).contains("no file"));
        let mut text = std::fs::read_to_string(&b).unwrap();
        text = text.replace("0.6", "0.7");
        std::fs::write(&b, text).unwrap();
        assert!(material_prior(&[b]).contains("not those that it was written with"));
    }
}
