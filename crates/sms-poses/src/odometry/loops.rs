//! Motions between keyframes that do not follow each other: where the camera comes back, errors that added up along its path
//! show.

use super::matching::{LEAST_INLIERS, likeness, motion_by_features};
use super::pose_graph::{Edge, settle};
use super::tracker::{Keyframe, trusted_registration};
use crate::PosesConfig;
use crate::graph::choose_pairs;
use crate::views::PreparedFrame;
use glamx::DPose3;
use rayon::prelude::*;
use sms_core::{Cancel, CoreError, Seed};
use std::collections::{BTreeSet, VecDeque};

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

/// Gives keyframes that edges connect one piece and one world: that of the piece with the most keyframes.
fn join_pieces(keyframes: &mut [Keyframe], edges: &[Edge]) {
    let mut reached = vec![false; keyframes.len()];
    let size = |piece: usize| keyframes.iter().filter(|k| k.piece == piece).count();
    let mut order: Vec<usize> = (0..keyframes.len()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse(size(keyframes[k].piece)), k));
    for root in order {
        if reached[root] {
            continue;
        }
        let piece = keyframes[root].piece;
        // Keyframes of the same piece keep their poses; those of others follow the first edge that reaches them.
        let mut queue: VecDeque<usize> =
            (0..keyframes.len()).filter(|&k| keyframes[k].piece == piece).collect();
        queue.iter().for_each(|&k| reached[k] = true);
        while let Some(at) = queue.pop_front() {
            for edge in edges.iter().filter(|e| e.from == at || e.to == at) {
                let (other, x_ao) = if edge.from == at {
                    (edge.to, edge.motion.x_ab)
                } else {
                    (edge.from, edge.motion.x_ab.inverse())
                };
                if reached[other] {
                    continue;
                }
                let moved = keyframes[at].x_wc * x_ao * keyframes[other].x_wc.inverse();
                let joined = keyframes[other].piece;
                for k in (0..keyframes.len()).filter(|&k| keyframes[k].piece == joined).collect::<Vec<_>>() {
                    keyframes[k].x_wc = moved * keyframes[k].x_wc;
                    keyframes[k].piece = piece;
                    reached[k] = true;
                    queue.push_back(k);
                }
            }
        }
    }
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
