//! Detection of objects missed by a source of masks.

use crate::geometry::{CLUSTER_STEPS, Clustered};
use crate::names::unique;
use crate::{GeometryConfig, MasksError};
use rayon::prelude::*;
use sms_core::{BACKGROUND, Cancel, LabelInfo, LabelMap, Labels, Progress, counted};
use sms_frames::Sequence;

/// Largest share of a missed object that may have a label, and that may lie beside labelled surfaces or a wall.
const EXPLAINED: f64 = 0.1;
/// Largest number of frames in which labels are looked up.
const FRAMES: usize = 40;

/// Adds unlabelled free-standing objects: clusters of [`crate::GeometryMasks`] with at most a tenth labelled and at
/// most a tenth beside labelled surfaces or a wall. They must lie completely within the image in a fifth of the frames
/// ([`GeometryConfig::min_seen_share`]). They are named `unknown_01`, `unknown_02`, … and take only unlabelled pixels.
/// Clusters that may belong to a labelled object or to the surroundings remain static background.
///
/// # Errors
/// [`MasksError::Input`] for invalid settings, [`MasksError::Interrupted`] when cancelled.
pub fn add_unknown(
    labels: &Labels,
    sequence: &Sequence,
    config: &GeometryConfig,
    progress: &dyn Progress,
    cancel: &Cancel,
) -> Result<Labels, MasksError> {
    config.validate()?;
    progress.begin("missed objects", CLUSTER_STEPS);
    let clustered = Clustered::new(sequence, config, progress, cancel)?;
    let explained = clustered.surfels_where(|p_w| {
        let (mut labelled, mut seen) = (0usize, 0usize);
        for (frame, map) in sequence.frames.iter().zip(&labels.maps).step_by(sequence.len().div_ceil(FRAMES))
        {
            let Some((u, v, z)) = frame.camera.project(p_w) else { continue };
            let Some((x, y)) = frame.camera.pixel_at(u, v) else { continue };
            let measured = f64::from(frame.depth[(x, y)]);
            if (measured - z).abs() < 0.012f64.max(0.015 * z) {
                seen += 1;
                labelled += usize::from(map[(x, y)] != BACKGROUND);
            }
        }
        2 * labelled > seen
    });
    let missed: Vec<bool> = clustered
        .clusters
        .iter()
        .map(|cluster| {
            let share = |holds: &dyn Fn(usize) -> bool| {
                cluster.iter().filter(|&&i| holds(i)).count() as f64 / cluster.len() as f64
            };
            share(&|i| explained[i]) <= EXPLAINED
                && share(&|i| !explained[i] && clustered.graph.of(i).any(|j| explained[j])) <= EXPLAINED
                && share(&|i| clustered.touches_wall(i)) <= EXPLAINED
        })
        .collect();
    if !missed.contains(&true) {
        progress.end("none");
        return Ok(labels.clone());
    }
    let seen = clustered.maps(sequence, config, cancel)?;
    let whole = seen_whole(&seen, missed.len());
    let least = (config.min_seen_share * seen.len() as f64).max(1.0);
    let mut labels = labels.clone();
    let first = labels.class_count();
    let ids: Vec<Option<u16>> = missed
        .iter()
        .zip(whole)
        .scan(first, |next, (&missed, whole)| {
            let is_new = missed && whole as f64 >= least;
            let id = (is_new && *next < usize::from(u16::MAX)).then_some(*next as u16);
            *next += usize::from(id.is_some());
            Some(id)
        })
        .collect();
    labels.maps.par_iter_mut().zip(&seen).for_each(|(map, seen)| {
        for (label, &cluster) in map.data.iter_mut().zip(&seen.data) {
            let id = usize::from(cluster).checked_sub(1).and_then(|c| ids[c]);
            if let (BACKGROUND, Some(id)) = (*label, id) {
                *label = id;
            }
        }
    });
    let added = ids.iter().flatten().count();
    for (count, id) in ids.into_iter().flatten().enumerate() {
        let taken: Vec<String> = labels.objects.iter().map(|o| o.name.clone()).collect();
        let name = unique(format!("unknown_{:02}", count + 1), &taken);
        labels.objects.push(LabelInfo { id, name, description: String::new() });
    }
    progress.end(&counted(added, "object", "objects"));
    Ok(labels)
}

/// Returns the number of frames that show each cluster (label minus 1) away from the image border.
fn seen_whole(maps: &[LabelMap], clusters: usize) -> Vec<usize> {
    let mut frames = vec![0; clusters];
    for map in maps {
        let (w, h) = map.size();
        let (mut seen, mut cut) = (vec![false; clusters + 1], vec![false; clusters + 1]);
        for (i, &label) in map.data.iter().enumerate() {
            let (x, y) = (i % w, i / w);
            seen[usize::from(label)] = true;
            cut[usize::from(label)] |= x == 0 || y == 0 || x + 1 == w || y + 1 == h;
        }
        for (k, count) in frames.iter_mut().enumerate() {
            *count += usize::from(seen[k + 1] && !cut[k + 1]);
        }
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Sensor, Solid, best_iou, scene, table_scene};
    use glamx::DVec3;
    use sms_core::{MaskSource, NoProgress};

    fn some_labels(maps: &[sms_core::LabelMap], keep: &[u16]) -> Labels {
        let info = |id| LabelInfo { id, name: format!("o{id}"), description: String::new() };
        let maps = maps
            .iter()
            .map(|m| {
                let mut map = m.clone();
                map.data.iter_mut().filter(|v| !keep.contains(v)).for_each(|v| *v = BACKGROUND);
                map
            })
            .collect();
        Labels { maps, objects: keep.iter().copied().map(info).collect(), source: MaskSource::Files }
    }

    #[test]
    fn missed_objects_become_unknown_and_nothing_else_changes() {
        let solids = table_scene();
        let (sequence, truth) = scene(&solids, Sensor { frames: 12, ..Sensor::default() }, 3);
        let given = some_labels(&truth, &[1, 2, 4]);
        let config = GeometryConfig::default();
        let full = add_unknown(&given, &sequence, &config, &NoProgress, &Cancel::new()).unwrap();
        let names: Vec<&str> = full.objects.iter().map(|o| o.name.as_str()).collect();
        assert_eq!(names, ["o1", "o2", "o4", "unknown_01", "unknown_02"]);
        for value in [3, 5] {
            let (iou, id) = best_iou(&truth, value, &full);
            assert!(iou > 0.88 && id >= 5, "solid {value}: {iou:.3} as {id}");
        }
        for (before, after) in given.maps.iter().zip(&full.maps) {
            assert!(before.data.iter().zip(&after.data).all(|(b, a)| *b == BACKGROUND || a == b));
        }
        // If all objects are labelled, nothing is added.
        let all = some_labels(&truth, &[1, 2, 3, 4, 5]);
        assert_eq!(add_unknown(&all, &sequence, &config, &NoProgress, &Cancel::new()).unwrap(), all);
    }

    #[test]
    fn objects_on_a_wall_or_never_whole_in_view_stay_static() {
        let wall = Solid::Box(DVec3::new(-0.25, 0.0, 0.2), DVec3::new(0.003, 0.5, 0.2), 0.0);
        let thing = |x: f64| Solid::Box(DVec3::new(x, 0.0, 0.04), DVec3::new(0.03, 0.05, 0.04), 0.0);
        let unknown = |solids: &[Solid], width: usize| {
            let (mut sequence, truth) = scene(solids, Sensor { frames: 12, ..Sensor::default() }, 5);
            // The images are cropped through the middle of the object.
            for frame in &mut sequence.frames {
                frame.depth = frame.depth.cropped((0, 0), (width, usize::MAX));
                frame.color = frame.color.cropped((0, 0), (width, usize::MAX));
                frame.normal_c = frame.normal_c.cropped((0, 0), (width, usize::MAX));
                frame.camera.intrinsics.width = width;
            }
            let maps: Vec<_> = truth.iter().map(|m| m.cropped((0, 0), (width, usize::MAX))).collect();
            let none = some_labels(&maps, &[]);
            let config = GeometryConfig::default();
            add_unknown(&none, &sequence, &config, &NoProgress, &Cancel::new()).unwrap().objects.len()
        };
        assert_eq!(unknown(&[wall, thing(0.0)], 320), 1);
        // A board that leans against the wall.
        let board = Solid::Box(DVec3::new(-0.237, 0.0, 0.04), DVec3::new(0.01, 0.05, 0.04), 0.0);
        assert_eq!(unknown(&[wall, board], 320), 0);
        assert_eq!(unknown(&[thing(0.0)], 320), 1);
        assert_eq!(unknown(&[thing(0.0)], 160), 0);
    }

    #[test]
    fn the_unlabelled_half_of_a_labelled_thing_stays_static() {
        // One mask covers only the lower half of a tower.
        let tower = |z: f64| Solid::Box(DVec3::new(0.0, 0.0, z), DVec3::new(0.04, 0.03, 0.03), 0.3);
        let (sequence, truth) =
            scene(&[tower(0.03), tower(0.09)], Sensor { frames: 12, ..Sensor::default() }, 5);
        let given = some_labels(&truth, &[1]);
        let full =
            add_unknown(&given, &sequence, &GeometryConfig::default(), &NoProgress, &Cancel::new()).unwrap();
        assert_eq!(full.objects.len(), 1);
    }
}
