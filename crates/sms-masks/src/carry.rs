//! Carries the user's edits of `labels.json` over to masks that are made again.

use crate::names::unique;
use crate::store::{LabelRow, load_label_rows, load_unmerged, save_rows};
use crate::{BACKGROUND, LabelInfo, LabelMap, Labels, MasksError};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Smallest intersection over union of a new object with the earlier one that it continues. Above one half, each object
/// has at most one counterpart.
const SAME: f64 = 0.5;

/// New masks with the edits of earlier ones.
#[derive(Debug, Clone)]
pub struct CarriedOver {
    /// The new id of every object whose id has changed, by the id that its source gave it.
    pub ids: BTreeMap<u16, u16>,
    /// Names of the edited objects that the new masks do not have.
    pub lost: Vec<String>,
}

/// Writes new masks into `dir`, as [`save_labels`](crate::save_labels) does, with the edits of the masks in `earlier`.
///
/// An earlier object is kept if its row was edited, if another one is merged into it, or if `has_values` is true for its
/// id. A new object that overlaps a kept one by more than half (intersection over union) gets its id, name, description
/// and merge. The id of a kept object never goes to another one, so that an id identifies an object across scans. Without
/// kept objects, or with another number of frames, the new masks are written as they are.
///
/// # Errors
/// [`MasksError::Write`]. Earlier masks that cannot be read have no edits.
pub fn save_labels_again(
    dir: &Path,
    labels: Labels,
    earlier: &Path,
    has_values: impl Fn(u16) -> bool,
) -> Result<CarriedOver, MasksError> {
    let rows = load_label_rows(earlier).unwrap_or_default();
    let is_target = |row: &LabelRow| rows.iter().any(|o| o.merge_into.as_ref() == Some(&row.name));
    let mut kept: Vec<&LabelRow> =
        rows.iter().filter(|row| row.is_edited() || is_target(row) || has_values(row.id)).collect();
    // The images of earlier masks without edits are not needed.
    let maps = if kept.is_empty() { Ok(Vec::new()) } else { load_unmerged(earlier, &rows) };
    let maps = maps.unwrap_or_else(|_| {
        kept.clear();
        Vec::new()
    });
    let counterparts = counterparts(&labels, &maps, &kept);
    let ids = new_ids(&labels.objects, &kept, &counterparts);
    let new_id = |id: u16| ids.get(&id).copied().unwrap_or(id);

    let continued: BTreeMap<u16, &LabelRow> =
        kept.iter().filter(|row| counterparts.contains_key(&row.id)).map(|row| (row.id, *row)).collect();
    // The name of a lost object stays free, so that its values cannot be taken for those of another one.
    let mut taken: Vec<String> = kept.iter().map(|row| row.name.clone()).collect();
    let mut objects: Vec<LabelRow> = Vec::new();
    for LabelInfo { id, name, description } in labels.objects {
        let id = new_id(id);
        let found_as = Some(name.clone());
        objects.push(match continued.get(&id) {
            Some(row) => LabelRow {
                description: if row.description.is_empty() { description } else { row.description.clone() },
                merge_into: row.merge_into.clone().filter(|into| continued.values().any(|o| o.name == *into)),
                found_as,
                ..(*row).clone()
            },
            None => {
                let name = unique(name, &taken);
                taken.push(name.clone());
                LabelRow { id, name, description, merge_into: None, found_as }
            }
        });
    }
    objects.sort_by_key(|o| o.id);
    let renumbered = |map: LabelMap| {
        let mut map = map;
        map.data.iter_mut().filter(|v| **v != BACKGROUND).for_each(|v| *v = new_id(*v));
        map
    };
    let maps: Vec<LabelMap> = labels.maps.into_iter().map(renumbered).collect();
    save_rows(dir, &maps, labels.source, objects)?;
    let lost = kept.iter().filter(|row| !continued.contains_key(&row.id)).map(|row| row.name.clone());
    Ok(CarriedOver { lost: lost.collect(), ids })
}

/// Returns the new id of the object that continues each kept one, by the id of the kept one.
fn counterparts(labels: &Labels, earlier: &[LabelMap], kept: &[&LabelRow]) -> BTreeMap<u16, u16> {
    if kept.is_empty() || earlier.len() != labels.maps.len() {
        return BTreeMap::new();
    }
    let mut both: BTreeMap<(u16, u16), f64> = BTreeMap::new();
    for (new, old) in labels.maps.iter().zip(earlier) {
        // The scans may differ in resolution.
        let column: Vec<usize> = (0..new.width).map(|x| x * old.width / new.width).collect();
        for y in 0..new.height {
            let row = y * old.height / new.height;
            for x in 0..new.width {
                *both.entry((old[(column[x], row)], new[(x, y)])).or_default() += 1.0;
            }
        }
    }
    let area = |of: &dyn Fn(&(u16, u16)) -> bool| -> f64 {
        both.iter().filter(|(pair, _)| of(pair)).map(|(_, n)| n).sum()
    };
    let mut found = BTreeMap::new();
    for (&(old, new), &shared) in &both {
        if new == BACKGROUND || !kept.iter().any(|row| row.id == old) {
            continue;
        }
        let union = area(&|pair| pair.0 == old) + area(&|pair| pair.1 == new) - shared;
        if shared > SAME * union {
            found.insert(old, new);
        }
    }
    found
}

/// Returns the ids that change: those of counterparts, and those of other objects with the id of a kept one.
fn new_ids(
    objects: &[LabelInfo],
    kept: &[&LabelRow],
    counterparts: &BTreeMap<u16, u16>,
) -> BTreeMap<u16, u16> {
    let mut ids: BTreeMap<u16, u16> = counterparts.iter().map(|(old, new)| (*new, *old)).collect();
    let mut taken: BTreeSet<u16> = kept.iter().map(|row| row.id).collect();
    let (own, others): (Vec<u16>, Vec<u16>) =
        objects.iter().map(|o| o.id).filter(|id| !ids.contains_key(id)).partition(|id| !taken.contains(id));
    taken.extend(own);
    for id in others {
        let Some(free) = (1..=u16::MAX).find(|free| !taken.contains(free)) else { break };
        taken.insert(free);
        ids.insert(id, free);
    }
    ids.retain(|from, to| from != to);
    ids
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MaskSource, Rename, load_labels, rename_labels, save_labels};
    use sms_core::{Image, atomic};

    /// Masks of one row of pixels; the objects are numbered from 1.
    fn labels(pixels: &[u16], names: &[&str]) -> Labels {
        let info = |(k, name): (usize, &&str)| LabelInfo {
            id: k as u16 + 1,
            name: (*name).into(),
            description: String::new(),
        };
        Labels {
            maps: vec![Image::from_vec(pixels.len(), 1, pixels.to_vec())],
            objects: names.iter().enumerate().map(info).collect(),
            source: MaskSource::Geometry,
        }
    }

    fn listed(dir: &Path) -> Vec<(u16, String, Option<String>)> {
        load_label_rows(dir).unwrap().into_iter().map(|o| (o.id, o.name, o.merge_into)).collect()
    }

    fn row(id: u16, name: &str) -> (u16, String, Option<String>) {
        (id, name.to_owned(), None)
    }

    const NAMES: [&str; 3] = ["object_01", "object_02", "object_03"];

    #[test]
    fn names_ids_and_merges_follow_their_objects() {
        let dir = tempfile::tempdir().unwrap();
        let [old, new] = ["old", "new"].map(|name| dir.path().join(name));
        save_labels(&old, &labels(&[1, 1, 2, 2, 3, 3, 0, 0], &NAMES)).unwrap();
        rename_labels(&old, &[Rename::new("object_01", "duck")]).unwrap();
        let path = old.join("labels.json");
        let mut file: serde_json::Value = atomic::read_json(&path).unwrap();
        file["objects"][2]["merge_into"] = "duck".into();
        atomic::write_json(&path, &file).unwrap();

        // At twice the resolution, the duck is the second object, the merged piece the third, and the first is new.
        let again = labels(&[2, 2, 2, 2, 0, 0, 0, 0, 3, 3, 3, 3, 1, 1, 1, 1], &NAMES);
        let done = save_labels_again(&new, again, &old, |_| false).unwrap();
        assert_eq!(done.ids, BTreeMap::from([(1, 2), (2, 1)]));
        assert!(done.lost.is_empty());
        // The first object's own name belongs to no kept object, so it stays.
        let merged = (3, "object_03".to_owned(), Some("duck".to_owned()));
        assert_eq!(listed(&new), [row(1, "duck"), row(2, "object_01"), merged]);
        assert_eq!(load_labels(&new).unwrap().maps[0].data, [1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2]);

        // The same again changes nothing.
        let third = dir.path().join("third");
        let again = labels(&[2, 2, 2, 2, 0, 0, 0, 0, 3, 3, 3, 3, 1, 1, 1, 1], &NAMES);
        save_labels_again(&third, again, &new, |_| false).unwrap();
        assert_eq!(listed(&third), listed(&new));
    }

    #[test]
    fn an_object_that_is_gone_keeps_its_id_and_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let [old, new] = ["old", "new"].map(|name| dir.path().join(name));
        save_labels(&old, &labels(&[1, 1, 2, 2, 0, 0], &NAMES[..2])).unwrap();
        // Object 1 has material values; the new object 1 is elsewhere.
        let done =
            save_labels_again(&new, labels(&[0, 0, 2, 2, 1, 1], &NAMES[..2]), &old, |id| id == 1).unwrap();
        assert_eq!(done.lost, ["object_01"]);
        assert_eq!(done.ids, BTreeMap::from([(1, 3)]));
        assert_eq!(listed(&new), [row(2, "object_02"), row(3, "object_01_2")]);
        assert_eq!(load_labels(&new).unwrap().maps[0].data, [0, 0, 2, 2, 3, 3]);
    }

    #[test]
    fn without_edits_new_masks_stay_as_they_are() {
        let dir = tempfile::tempdir().unwrap();
        let [old, new, plain] = ["old", "new", "plain"].map(|name| dir.path().join(name));
        save_labels(&old, &labels(&[1, 1, 2, 2], &NAMES[..2])).unwrap();
        let again = labels(&[2, 2, 1, 1], &NAMES[..2]);
        let done = save_labels_again(&new, again.clone(), &old, |_| false).unwrap();
        save_labels(&plain, &again).unwrap();
        assert!(done.ids.is_empty() && done.lost.is_empty());
        for file in ["labels.json", "000000.png"] {
            assert_eq!(std::fs::read(new.join(file)).unwrap(), std::fs::read(plain.join(file)).unwrap());
        }
        // No earlier masks at all.
        save_labels_again(&new, again, &dir.path().join("absent"), |_| true).unwrap();
        assert_eq!(listed(&new), listed(&plain));
    }
}
