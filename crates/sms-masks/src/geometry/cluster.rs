//! Clustering of non-static surfels into objects.

use super::GeometryConfig;
use super::assembly::{FOOT_M, OVER, merge_bodies};
use super::balls::{Ball, balls};
use super::extents::{extents, is_ragged, quantile};
use super::fuse::{Neighbors, Surfel};
use super::planes::{StaticPlane, is_seen_through};
use super::posts::{Footprint, Post};
use super::seams::{LevelSeam, level_seams};
use super::segments::{Border, Segments};
use glamx::DVec3;
use rayon::prelude::*;
use sms_core::{Cancel, CoreError};
use sms_frames::Sequence;

/// Returns the objects as sorted lists of surfels, the largest first.
///
/// # Errors
/// [`CoreError::Interrupted`] once a stop was requested.
pub(crate) fn clusters(
    surfels: &[Surfel],
    graph: &Neighbors,
    is_static: &[bool],
    assembly_of: &[Option<usize>],
    planes: &[StaticPlane],
    sequence: &Sequence,
    config: &GeometryConfig,
    cancel: &Cancel,
) -> Result<Vec<Vec<usize>>, CoreError> {
    let pieces = graph.components(|i| !is_static[i] && assembly_of[i].is_none());
    let smallest = (config.min_area_m2 / config.voxel_m.powi(2)) as usize;
    let mut assemblies: Vec<Vec<usize>> =
        vec![vec![]; assembly_of.iter().flatten().max().map_or(0, |k| k + 1)];
    for (i, assembly) in assembly_of.iter().enumerate().filter(|(i, _)| !is_static[*i]) {
        assembly.iter().for_each(|&k| assemblies[k].push(i));
    }
    // The lowest parts of assemblies were classified as noise of the ground.
    let mut feet = Vec::new();
    let pieces = pieces.into_iter().filter(|piece| {
        let z = |share| quantile(piece.iter().map(|&i| surfels[i].p_w.z), share);
        let under = piece.iter().flat_map(|&i| graph.of(i)).find_map(|j| assembly_of[j]);
        let foot = under.filter(|_| z(0.98) - z(0.02) < FOOT_M);
        feet.extend(foot.map(|k| (k, piece.clone())));
        foot.is_none()
    });
    let mut parts = Vec::new();
    for piece in pieces.filter(|p| p.len() >= smallest) {
        let balls = balls(surfels, graph, &piece, config.voxel_m, cancel)?;
        parts.extend(split(surfels, graph, &piece, &[], &balls, config).into_members());
    }
    feet.into_iter().for_each(|(k, piece)| assemblies[k].extend(piece));
    assemblies.iter_mut().for_each(|members| members.sort_unstable());
    let mut standing = Vec::new();
    for members in &assemblies {
        cancel.check()?;
        standing.extend(bodies(surfels, graph, members, config));
    }
    let parts = join_legs(surfels, parts, |p_w| is_seen_through(p_w, sequence));
    // A free-standing body may be as long as its whole assembly.
    let [part, body] = [1.2, OVER].map(|times| times * config.max_structure_m);
    let mut objects: Vec<Vec<usize>> = parts
        .into_iter()
        .map(|object| (object, part))
        .chain(standing.into_iter().map(|object| (object, body)))
        .collect::<Vec<_>>()
        .into_par_iter()
        .filter(|(object, longest)| {
            is_plausible(surfels, graph, object, *longest, is_static, planes, sequence, config)
        })
        .map(|(object, _)| object)
        .collect();
    objects.sort_by_key(|o| (std::cmp::Reverse(o.len()), o[0]));
    objects.truncate(usize::from(u16::MAX) - 1);
    Ok(objects)
}

/// Returns the bodies of an assembly, whose surfels are `members`.
pub(crate) fn bodies(
    surfels: &[Surfel],
    graph: &Neighbors,
    members: &[usize],
    config: &GeometryConfig,
) -> Vec<Vec<usize>> {
    let smallest = (config.min_area_m2 / config.voxel_m.powi(2)) as usize;
    let seams = level_seams(surfels, members, config.voxel_m);
    let mut segments = split(surfels, graph, members, &seams, &[], config);
    merge_bodies(&mut segments, surfels, graph, members, &seams, smallest, config.voxel_m.powi(2));
    segments.into_members()
}

/// A piece longer than an object stands free if at most this share of it lies beside static surfaces.
const TOUCHING: f64 = 0.1;

/// A piece with less surface than this is small, m²: a cube of 13 mm.
const SMALL_M2: f64 = 9e-4;
/// Smallest share of frames that show a small piece: noise and rims of other objects seldom repeat in one place.
const SMALL_SEEN: f64 = 0.5;

/// Returns whether a piece has the size of an object, stands out from the planes around it, and is seen often enough.
fn is_plausible(
    surfels: &[Surfel],
    graph: &Neighbors,
    object: &[usize],
    longest: f64,
    is_static: &[bool],
    planes: &[StaticPlane],
    sequence: &Sequence,
    config: &GeometryConfig,
) -> bool {
    let area = object.len() as f64 * config.voxel_m.powi(2);
    let [_, middle, long] = extents(surfels, object);
    if area < config.min_area_m2
        || long < config.min_object_m
        || middle < 0.9 * config.min_object_m
        || is_ragged(area, middle, long)
        || long > longest
    {
        return false;
    }
    if long > 1.2 * config.max_object_m {
        let touches = |&&i: &&usize| graph.of(i).any(|j| is_static[j]);
        let touching = object.iter().filter(touches).count();
        if touching as f64 > TOUCHING * object.len() as f64 {
            return false;
        }
    }
    // The 90th percentile of the heights over each plane counts, which excludes ragged rims and the skin of a plane.
    let stands_out = planes.iter().all(|plane| {
        let mut heights: Vec<f64> = object.iter().map(|&i| plane.height(surfels[i].p_w).abs()).collect();
        let at = heights.len() * 9 / 10;
        *heights.select_nth_unstable_by(at, f64::total_cmp).1 > (0.5 * config.min_object_m).max(plane.band_m)
    });
    let step = object.len().div_ceil(200);
    let seen = sequence.frames.iter().filter(|frame| {
        let (mut visible, mut all) = (0, 0);
        for &i in object.iter().step_by(step) {
            all += 1;
            let Some((u, v, z)) = frame.camera.project(surfels[i].p_w) else { continue };
            let Some((x, y)) = frame.camera.pixel_at(u, v) else { continue };
            let measured = f64::from(frame.depth[(x, y)]);
            visible += usize::from((measured - z).abs() < 0.012f64.max(0.015 * z));
        }
        visible * 10 >= all
    });
    // Smaller pieces must be visible in more frames.
    let share = if area < SMALL_M2 { config.min_seen_share.max(SMALL_SEEN) } else { config.min_seen_share };
    stands_out && seen.count() as f64 >= (share * sequence.len() as f64).max(1.0)
}

/// Splits a connected piece where two convex objects meet.
///
/// The method follows locally convex connected patches (Stein et al., "Object partitioning using local convexity", CVPR
/// 2014), with borders judged as a whole. Patches merge first where their border bends inwards least (and their colours
/// differ least), until every border is a crease. Segments too small to be objects join the neighbour with the longest
/// common border. Not every crease separates: see [`are_distinct`]. Level `seams` always separate, and `balls` are
/// never cut.
fn split(
    surfels: &[Surfel],
    graph: &Neighbors,
    piece: &[usize],
    seams: &[LevelSeam],
    balls: &[Ball],
    config: &GeometryConfig,
) -> Segments {
    let voxel = config.voxel_m;
    let mut segments =
        Segments::patches(surfels, graph, piece, 3.0 * voxel, 1.6 * voxel, config.crease_rad, seams, balls);
    let smallest = (DETAIL_M2 / voxel.powi(2)) as usize;
    let length = extents(surfels, piece)[2];
    // Parts of one object may also be connected by a thread. Only in clutter is a thread noise between objects.
    let is_thread = |s: &Segments, a: usize, b: usize, border: &Border| {
        length > config.clutter_m
            && s.size(a).min(s.size(b)) >= smallest
            && s.width(a, b, border) < THREAD
            && neck(s, a, b, border) < THREAD_NECK
    };
    // Greedy merging sometimes leaks through a border. It runs twice, led by colour and by shape; a border that either
    // run keeps is kept.
    let [by_color, by_shape] = LIGHTS.map(|light| {
        let mut merged = segments.clone();
        merged.merge_convex(config.crease_share, light, is_thread);
        merged
    });
    segments.merge_agreed(&by_color, &by_shape);
    segments.merge_small(|members| {
        if members.len() < smallest {
            return true;
        }
        let [_, middle, long] = extents(surfels, members);
        middle < config.min_object_m || long < 1.5 * config.min_object_m
    });
    segments.merge_while(
        |s, a, b, border| {
            if are_distinct(s, a, b, border, length, config) { 0.0 } else { 1.0 / (1.0 + s.contrast(a, b)) }
        },
        0.0,
    );
    segments
}

/// Change of colour between neighbouring patches that light alone may cause, in levels: when colour leads and when
/// shape leads.
const LIGHTS: [f64; 2] = [15.0, 60.0];

/// Largest width ([`Segments::width`]) of a thread between large segments: noise in a narrow gap.
const THREAD: f64 = 12.0;
/// Largest ratio of its width to the smaller segment. The legs of a stool join over several of their widths.
const THREAD_NECK: f64 = 1.2;

/// A segment with less surface than this (m²) is a detail of its neighbours, regardless of colour.
const DETAIL_M2: f64 = 2.5e-3;

/// Width of a border in widths of the smaller segment. Below 1, the contact is narrower than the cross-section.
fn neck(s: &Segments, a: usize, b: usize, border: &Border) -> f64 {
    let smaller = if s.size(a) < s.size(b) { a } else { b };
    border.spread.extents()[2] / s.spread(smaller).extents()[1].max(1e-6)
}

/// Returns whether segment `a` is the bottom of a hollow with walls `b`: it is flat, `b` surrounds it, and `b` rises on
/// the side that `a` faces.
fn is_inside(s: &Segments, a: usize, b: usize, border: &Border) -> bool {
    let (own, ring) = (s.spread(a).extents(), border.spread.extents());
    let rises = (s.spread(b).center() - s.spread(a).center()).dot(s.facing(a).normalize_or_zero());
    s.facing(a).length() > 0.8
        && own[0] < 0.3 * own[1]
        && ring[1] > 0.9 * own[1]
        && ring[2] > 0.9 * own[2]
        && rises > 2.0 * own[0].max(0.005)
}

/// Returns whether two segments with a crease between them are two objects.
///
/// Evidence is a colour difference across the crease, or a border narrower than either side. In a piece of an object's
/// size (with a toy's head or a bottle's cap) the crease must be sharp, and neither side a mere detail. Larger pieces
/// need less evidence, and in pieces larger than most objects a level crease separates an object from its support.
fn are_distinct(
    s: &Segments,
    a: usize,
    b: usize,
    border: &Border,
    length: f64,
    config: &GeometryConfig,
) -> bool {
    if border.is_seam() {
        return true;
    }
    let contrast = s.contrast(a, b);
    if is_inside(s, a, b, border) || is_inside(s, b, a, border) {
        return false;
    }
    let sharp = border.crease > 0.5 * border.pairs;
    let neck = neck(s, a, b, border);
    // A round head with the colour of its body is not a ball.
    if border.is_round() && (contrast > 1.0 || neck < 0.6) {
        return true;
    }
    let narrow = sharp && (neck < 0.6 || (neck < 0.75 && contrast > 1.0));
    if length > config.clutter_m {
        let [thin, middle, _] = border.spread.extents();
        let level = border.spread.normal().z.abs() > 0.95 && thin < 0.25 * middle;
        let bent = border.crease / border.pairs;
        if bent < 0.25 && contrast < 2.4 {
            return false;
        }
        let width = s.width(a, b, border);
        return (contrast > 1.2 && (bent > 0.3 || neck < 1.0 || contrast > 2.4))
            || narrow
            || width < THREAD
            || (length > 0.35 && level && bent > 0.35);
    }
    let least = s.size(a).min(s.size(b)) as f64 > 0.2 * s.size(a).max(s.size(b)) as f64;
    narrow || (sharp && least && contrast > 1.5)
}

/// Merges posts into the objects they carry. The underside of a table hides the upper ends of its legs. A slender,
/// upright object with something above its axis belongs to the object around its upper end, if that object has other
/// posts or reaches the ground. If the upper end is hidden, the post belongs to the lowest object above it, unless
/// cameras see through the gap (`is_open`).
pub(crate) fn join_legs(
    surfels: &[Surfel],
    objects: Vec<Vec<usize>>,
    is_open: impl Fn(DVec3) -> bool,
) -> Vec<Vec<usize>> {
    /// Largest distance between a post's top and the rim of its load, in addition to half of the post's width.
    const INSET_M: f64 = 0.035;
    /// Largest thickness of a post's load.
    const TOP_M: f64 = 0.06;
    /// Largest height of an object over a post: a load on the table top hides the top.
    const OVER_M: f64 = 0.3;
    /// A post ends at the object above if the gap is smaller than this.
    const CLOSE_M: f64 = 0.03;
    let mut carried_by: Vec<Option<usize>> = vec![None; objects.len()];
    let lowest: Vec<f64> =
        objects.iter().map(|o| quantile(o.iter().map(|&i| surfels[i].p_w.z), 0.02)).collect();
    let posts: Vec<Option<Post>> =
        objects.iter().map(|o| Post::of(surfels, o).filter(|_| o.len() >= 50)).collect();
    let footprints: Vec<Footprint> = objects.iter().map(|o| Footprint::of(surfels, o)).collect();
    for (a, members) in objects.iter().enumerate() {
        let Some(post) = &posts[a] else { continue };
        let (top, width, axis) = (post.top_m, post.width_m, post.axis_w);
        let (mut covered, mut best): (bool, Option<(usize, usize)>) = (false, None);
        for (b, other) in objects.iter().enumerate().filter(|(b, _)| *b != a) {
            let mut around = 0;
            for p in other.iter().map(|&i| surfels[i].p_w) {
                let (over, aside) = (p.z - top, p.truncate().distance(axis));
                covered |= aside < f64::max(0.5 * width, 0.01) && over > 0.0 && over < OVER_M;
                around += usize::from(aside < 0.5 * width + INSET_M && over > -0.02 && over < TOP_M);
            }
            // The first of equal candidates. It is not a post of the same object, since posts are slender.
            if around >= 5 && other.len() > members.len() && best.is_none_or(|(most, _)| around > most) {
                best = Some((around, b));
            }
        }
        let hidden = || {
            let others = (0..objects.len())
                .filter(|&b| posts[b].is_none() && objects[b].len() > members.len())
                .map(|b| (b, objects[b].as_slice(), &footprints[b]));
            let (gap, b) = post.lowest_over(surfels, others)?;
            let between = [0.25, 0.5, 0.75].map(|share| axis.extend(top + share * gap));
            (gap < CLOSE_M || between.iter().filter(|p| is_open(**p)).count() < 2).then_some(b)
        };
        carried_by[a] = best.filter(|_| covered).map(|(_, b)| b).or_else(hidden);
    }
    let legs = |b: usize| carried_by.iter().filter(|c| **c == Some(b)).count();
    let mut joined: Vec<Option<Vec<usize>>> = objects.into_iter().map(Some).collect();
    for a in 0..joined.len() {
        let Some(b) = carried_by[a] else { continue };
        // The load must not be a post itself.
        if carried_by[b].is_some() || (legs(b) < 2 && lowest[b] > lowest[a] + 0.03) {
            continue;
        }
        if let (Some(post), Some(_)) = (joined[a].take(), &joined[b]) {
            joined[b].get_or_insert_default().extend(post);
        }
    }
    let mut joined: Vec<Vec<usize>> = joined.into_iter().flatten().collect();
    joined.iter_mut().for_each(|m| m.sort_unstable());
    joined
}
