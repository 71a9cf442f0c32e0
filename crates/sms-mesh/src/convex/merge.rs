//! Merges parts where cuts were unnecessary, and to meet the part budget.

use crate::convex::parts::HullPart;
use crate::convex::piece::SLIGHT;
use crate::convex::solid::{Decomposition, rv};
use crate::convex::sweep::GrowingHull;
use crate::convex::work::Work;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Share of the parts' volume below which a part is a sliver.
const SLIVER: f64 = 3e-4;

/// A possible union of two parts.
struct Union {
    part: HullPart,
    /// Hull volume that the union adds.
    added: f64,
    /// Whether the union is within the threshold; `None` if not computed yet.
    allowed: Option<bool>,
}

fn union(a: &HullPart, b: &HullPart, gap: f64, hull: &mut GrowingHull) -> Option<Union> {
    let apart = (a.min - b.max).max(b.min - a.max).max_element();
    if apart > gap {
        return None;
    }
    let hull_volume = hull.refill(SLIGHT, a.points.iter().chain(&b.points));
    let part = HullPart::new(hull.vertices(), a.volume + b.volume, hull_volume)?;
    Some(Union { part, added: hull_volume - a.hull_volume - b.hull_volume, allowed: None })
}

/// Merges parts, starting with the union that adds the least volume. Unions within the threshold that add at most
/// `most_added` are made, and more while there are more than `max_parts`.
pub(crate) fn merge(
    parts: Vec<HullPart>,
    task: Decomposition,
    max_parts: usize,
    most_added: f64,
) -> Vec<HullPart> {
    let mut alive: BTreeMap<usize, HullPart> = parts.into_iter().enumerate().collect();
    let mut unions: BTreeMap<(usize, usize), Union> = BTreeMap::new();
    let mut next_id = alive.len();
    let mut fresh: Vec<usize> = alive.keys().copied().collect();
    while alive.len() > 1 {
        let ids: Vec<usize> = alive.keys().copied().collect();
        let pairs: Vec<(usize, usize)> =
            fresh.iter().flat_map(|&b| ids.iter().filter(move |&&a| a < b).map(move |&a| (a, b))).collect();
        let found: Vec<Option<Union>> = pairs
            .par_iter()
            .map_init(GrowingHull::default, |hull, &(a, b)| {
                let union = union(&alive[&a], &alive[&b], task.threshold, hull);
                task.work.add(1 + hull.take_steps());
                union
            })
            .collect();
        unions.extend(pairs.into_iter().zip(found).filter_map(|(k, u)| Some((k, u?))));
        let forced = alive.len() > max_parts;
        let key = match best(&mut unions, task, (!forced).then_some(most_added)) {
            // The remaining parts do not touch: only unions across gaps can meet the budget.
            None if forced => across_gap(&alive, &mut unions, task.work),
            key => key,
        };
        let Some((a, b)) = key else { break };
        let Some(union) = unions.remove(&(a, b)) else { break };
        unions.retain(|&(i, j), _| i != a && i != b && j != a && j != b);
        alive.remove(&a);
        alive.remove(&b);
        alive.insert(next_id, union.part);
        fresh = vec![next_id];
        next_id += 1;
    }
    drop_slivers(alive)
}

/// Removes slivers left by cuts: they add no support and cause problems in physics engines. Each sliver joins the part
/// that grows least by the union, or is dropped if that part would grow noticeably.
fn drop_slivers(mut alive: BTreeMap<usize, HullPart>) -> Vec<HullPart> {
    let total: f64 = alive.values().map(|p| p.hull_volume).sum();
    let slivers: Vec<usize> =
        alive.iter().filter(|(_, p)| p.hull_volume < SLIVER * total).map(|(&k, _)| k).collect();
    let mut hull = GrowingHull::default();
    for id in slivers {
        if alive.len() < 2 {
            break;
        }
        let Some(sliver) = alive.remove(&id) else { continue };
        let best = alive
            .iter()
            .filter_map(|(&k, p)| Some((k, union(p, &sliver, 0.02, &mut hull)?)))
            .min_by(|a, b| a.1.added.total_cmp(&b.1.added).then(a.0.cmp(&b.0)));
        if let Some((k, union)) = best
            && union.added < SLIVER * total
        {
            alive.insert(k, union.part);
        }
    }
    alive.into_values().collect()
}

/// Returns the union that adds the least volume. With `most_added`, only unions within the threshold that add at most
/// this volume count.
fn best(
    unions: &mut BTreeMap<(usize, usize), Union>,
    task: Decomposition,
    most_added: Option<f64>,
) -> Option<(usize, usize)> {
    let mut hull = GrowingHull::default();
    loop {
        let (key, union) = unions
            .iter_mut()
            .filter(|(_, u)| most_added.is_none_or(|most| u.allowed != Some(false) && u.added <= most))
            .min_by(|a, b| a.1.added.total_cmp(&b.1.added).then(a.0.cmp(b.0)))?;
        let is_allowed = || {
            let surplus = union.part.hull_volume - union.part.volume;
            rv(surplus) <= task.threshold && {
                hull.refill(SLIGHT, &union.part.points);
                task.is_convex(&hull, surplus, 1.0)
            }
        };
        if most_added.is_none() || *union.allowed.get_or_insert_with(is_allowed) {
            return Some(*key);
        }
    }
}

fn across_gap(
    alive: &BTreeMap<usize, HullPart>,
    unions: &mut BTreeMap<(usize, usize), Union>,
    work: &Work,
) -> Option<(usize, usize)> {
    let mut hull = GrowingHull::default();
    for (&a, pa) in alive {
        for (&b, pb) in alive.range(a + 1..) {
            if let Some(u) = union(pa, pb, f64::INFINITY, &mut hull) {
                unions.entry((a, b)).or_insert(u);
            }
        }
    }
    work.add(hull.take_steps());
    unions.iter().min_by(|a, b| a.1.added.total_cmp(&b.1.added).then(a.0.cmp(b.0))).map(|(k, _)| *k)
}
