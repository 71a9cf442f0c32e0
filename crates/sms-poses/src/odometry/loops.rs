//! Motions between keyframes that do not follow each other: where the camera comes back, errors that added up along its path
//! show.

use super::matching::{LEAST_INLIERS, likeness, motion_by_features};
use super::pose_graph::{Edge, settle};
use super::tracker::{GATE_SHARE, Keyframe, trusted_registration};
use crate::PosesConfig;
use crate::graph::choose_pairs;
use crate::views::PreparedFrame;
use glamx::{DPose3, DVec3};
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, Seed};
use std::collections::BTreeSet;

/// Most similar keyframes that each keyframe is compared with.
const ALIKE: usize = 4;
/// Rounds of comparing keyframes that overlap by their poses.
const ROUNDS: usize = 2;

/// Adds edges between keyframes that show the same place, by appearance and by their poses, and settles all poses. Pieces that
/// an edge joins become one. Returns the number of edges that were added and kept.
pub(super) fn close_loops(
    keyframes: &mut [Keyframe],
    edges: &mut Vec<Edge>,
    config: &PosesConfig,
    cancel: &Cancel,
) -> Result<usize, CoreError> {
    let alike = alike_pairs(keyframes, edges);
    let by_corners = |&(from, to): &(usize, usize)| {
        let (a, b) = (&keyframes[from].view, &keyframes[to].view);
        let seed = Seed(0).derive_index("loop", (from * keyframes.len() + to) as u64);
        let start = motion_by_features(&a.features, &b.features, seed)?;
        let motion = trusted_registration(a, b, &start, config)?;
        Some(Edge { from, to, motion, is_tracked: false })
    };
    let found: Vec<Option<Edge>> = alike.par_iter().map(by_corners).collect();
    edges.extend(found.into_iter().flatten());
    cancel.check()?;
    join_pieces(keyframes, edges);
    settle_poses(keyframes, edges);
    for _ in 0..ROUNDS {
        cancel.check()?;
        let near = near_pairs(keyframes, edges, config);
        let by_pose = |&(from, to): &(usize, usize)| {
            let (a, b) = (&keyframes[from], &keyframes[to]);
            let motion = trusted_registration(&a.view, &b.view, &(a.x_wc.inverse() * b.x_wc), config)?;
            Some(Edge { from, to, motion, is_tracked: false })
        };
        let found: Vec<Option<Edge>> = near.par_iter().map(by_pose).collect();
        edges.extend(found.into_iter().flatten());
        settle_poses(keyframes, edges);
    }
    Ok(edges.iter().filter(|e| !e.is_tracked).count())
}

fn known(edges: &[Edge]) -> BTreeSet<(usize, usize)> {
    edges.iter().map(|e| (e.from.min(e.to), e.from.max(e.to))).collect()
}

/// Returns the pairs of keyframes that look most alike.
fn alike_pairs(keyframes: &[Keyframe], edges: &[Edge]) -> Vec<(usize, usize)> {
    let known = known(edges);
    let best = |i: usize| {
        let mut alike: Vec<(usize, usize)> = (0..i)
            .filter(|&j| !known.contains(&(j, i)))
            .map(|j| (likeness(&keyframes[j].view.features, &keyframes[i].view.features), j))
            .filter(|(count, _)| *count >= LEAST_INLIERS)
            .collect();
        alike.sort_by_key(|(count, j)| (std::cmp::Reverse(*count), *j));
        alike.into_iter().take(ALIKE).map(|(_, j)| (j, i)).collect::<Vec<_>>()
    };
    (0..keyframes.len()).into_par_iter().flat_map_iter(best).collect()
}

/// Returns the pairs of keyframes of one piece that overlap most by their poses.
fn near_pairs(keyframes: &[Keyframe], edges: &[Edge], config: &PosesConfig) -> Vec<(usize, usize)> {
    let known = known(edges);
    let pieces: BTreeSet<usize> = keyframes.iter().map(|k| k.piece).collect();
    let of_piece = |piece: usize| {
        let members: Vec<usize> = (0..keyframes.len()).filter(|&k| keyframes[k].piece == piece).collect();
        let views: Vec<&PreparedFrame> = members.iter().map(|&k| &keyframes[k].view.frame).collect();
        let poses: Vec<DPose3> = members.iter().map(|&k| keyframes[k].x_wc).collect();
        let pairs = choose_pairs(&views, &poses, config).pairs;
        pairs.into_iter().map(|(i, j)| (members[i], members[j])).collect::<Vec<_>>()
    };
    pieces.into_iter().flat_map(of_piece).filter(|pair| !known.contains(pair)).collect()
}

/// A place that an edge gives to the keyframes of another piece.
#[derive(Debug, Clone, Copy)]
struct Bridge {
    /// The other piece.
    piece: usize,
    /// Motion that carries its world to that of the first piece.
    moved: DPose3,
    /// Point that its keyframe sees, in its world.
    seen_w: DVec3,
    /// Distance within which two places of the point are the same, metres.
    gate_m: f64,
}

/// Gives keyframes that edges connect one piece and one world: that of the piece with the most keyframes. Of several edges between
/// two pieces, that on which most others agree tells their place: a wrong one is alone.
fn join_pieces(keyframes: &mut [Keyframe], edges: &[Edge]) {
    let size = |piece: usize| keyframes.iter().filter(|k| k.piece == piece).count();
    let mut order: Vec<usize> = (0..keyframes.len()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse(size(keyframes[k].piece)), k));
    for root in order {
        let piece = keyframes[root].piece;
        while let Some(bridge) = firmest(&bridges(keyframes, edges, piece)) {
            for keyframe in keyframes.iter_mut().filter(|k| k.piece == bridge.piece) {
                keyframe.x_wc = bridge.moved * keyframe.x_wc;
                keyframe.piece = piece;
            }
        }
    }
}

/// Returns the places that edges give to other pieces in the world of a piece.
fn bridges(keyframes: &[Keyframe], edges: &[Edge], piece: usize) -> Vec<Bridge> {
    let of = |edge: &Edge| {
        let (from, to) = (&keyframes[edge.from], &keyframes[edge.to]);
        let (own, other, x_ao) = match (from.piece == piece, to.piece == piece) {
            (true, false) => (from, to, edge.motion.x_ab),
            (false, true) => (to, from, edge.motion.x_ab.inverse()),
            _ => return None,
        };
        let depth_m = other.view.mean_depth_m();
        Some(Bridge {
            piece: other.piece,
            moved: own.x_wc * x_ao * other.x_wc.inverse(),
            seen_w: other.x_wc.transform_point(DVec3::Z * depth_m),
            gate_m: GATE_SHARE * depth_m,
        })
    };
    edges.iter().filter_map(of).collect()
}

/// Returns the bridge with the most bridges to the same piece that agree with it, the first of equal ones.
fn firmest(bridges: &[Bridge]) -> Option<Bridge> {
    let agreeing = |a: &Bridge| {
        let agrees = |b: &&Bridge| {
            let off = a.moved.transform_point(a.seen_w).distance(b.moved.transform_point(a.seen_w));
            a.piece == b.piece && off <= a.gate_m
        };
        bridges.iter().filter(agrees).count()
    };
    bridges.iter().rev().max_by_key(|a| agreeing(a)).copied()
}

/// Settles the poses of all pieces, and drops the edges that contradict the others.
fn settle_poses(keyframes: &mut [Keyframe], edges: &mut Vec<Edge>) {
    let held = connected(keyframes, edges);
    let mut poses: Vec<DPose3> = keyframes.iter().map(|k| k.x_wc).collect();
    let agrees = settle(&mut poses, edges, &held);
    keyframes.iter_mut().zip(poses).for_each(|(k, x_wc)| k.x_wc = x_wc);
    let mut agrees = agrees.into_iter();
    edges.retain(|e| agrees.next().unwrap_or(true) || e.is_tracked);
    // Pieces that only dropped edges had joined are pieces again.
    connected(keyframes, edges);
}

/// Makes the keyframes that edges connect one piece each; returns the first keyframe of each piece.
fn connected(keyframes: &mut [Keyframe], edges: &[Edge]) -> Vec<usize> {
    (0..keyframes.len()).for_each(|k| keyframes[k].piece = k);
    let mut is_changed = true;
    while is_changed {
        is_changed = false;
        for edge in edges {
            let least = keyframes[edge.from].piece.min(keyframes[edge.to].piece);
            for end in [edge.from, edge.to] {
                is_changed |= keyframes[end].piece != least;
                keyframes[end].piece = least;
            }
        }
    }
    (0..keyframes.len()).filter(|&k| keyframes[k].piece == k).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;

    #[test]
    fn the_place_on_which_most_bridges_agree_wins() {
        let bridge = |piece, shift_m: f64| Bridge {
            piece,
            moved: DPose3::from_parts(DVec3::X * shift_m, DQuat::from_rotation_z(0.3)),
            seen_w: DVec3::new(0.2, -0.1, 1.0),
            gate_m: 0.06,
        };
        // A wrong bridge comes first, and another piece has a bridge at the same place.
        let all = [bridge(1, 2.0), bridge(2, 2.0), bridge(1, 0.5), bridge(1, 0.52)];
        let found = firmest(&all).unwrap();
        assert_eq!((found.piece, found.moved.translation.x), (1, 0.5));
        // Alone, each is trusted.
        assert_eq!(firmest(&all[..1]).unwrap().moved.translation.x, 2.0);
        assert!(firmest(&[]).is_none());
    }
}
