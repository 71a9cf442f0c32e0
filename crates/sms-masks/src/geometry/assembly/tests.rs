//! Assemblies of boxes with known bodies: tests which are free-standing and how they are split.

use super::super::cluster::{bodies, join_legs};
use super::super::fuse::coarsen;
use super::super::seams::level_seams;
use super::*;
use crate::voxels::key_of;

/// A box that belongs to one body.
#[derive(Debug, Clone, Copy)]
struct Block {
    low: DVec3,
    high: DVec3,
    color: [f32; 3],
    body: usize,
}

const WOOD: [f32; 3] = [200.0, 160.0, 110.0];
const BLUE: [f32; 3] = [40.0, 80.0, 160.0];
const GREEN: [f32; 3] = [40.0, 130.0, 70.0];

fn block(body: usize, color: [f32; 3], low: [f64; 3], high: [f64; 3]) -> Block {
    Block { low: DVec3::from_array(low), high: DVec3::from_array(high), color, body }
}

/// Four legs and the top on them.
fn table(body: usize, half: [f64; 2], height: f64, inset: f64, leg: f64) -> Vec<Block> {
    let [x, y] = half;
    let mut blocks = vec![block(body, WOOD, [-x, -y, height - 0.024], [x, y, height])];
    for (sx, sy) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (a, b) = (sx * (x - inset), sy * (y - inset));
        let (c, d) = (a - sx * leg, b - sy * leg);
        let (low, high) = ([a.min(c), b.min(d), 0.0], [a.max(c), b.max(d), height - 0.024]);
        blocks.push(block(body, WOOD, low, high));
    }
    blocks
}

/// The visible cloud of some blocks, and the body of each surfel.
struct Cloud {
    surfels: Vec<Surfel>,
    graph: Neighbors,
    body: Vec<usize>,
    config: GeometryConfig,
}

impl Cloud {
    /// Returns the cloud without faces that look down, surfaces inside or between blocks, and points accepted by
    /// `is_hidden`.
    fn of(blocks: &[Block], is_hidden: impl Fn(DVec3) -> bool) -> Self {
        let config = GeometryConfig::default();
        let cell = config.voxel_m;
        let mut found: BTreeMap<u64, (Surfel, usize)> = BTreeMap::new();
        // Samples are finer than the cells and averaged, so that no row of cells is empty.
        let fine = 0.5 * cell;
        for b in blocks {
            for (axis, sign) in [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0), (2, 1.0)] {
                let n_w = DVec3::AXES[axis] * sign;
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                let size = b.high - b.low;
                let steps = |k: usize| (size[k] / fine).round().max(1.0) as usize;
                for (i, j) in (0..steps(u)).flat_map(|i| (0..steps(v)).map(move |j| (i, j))) {
                    let mut p_w = if sign > 0.0 { b.high } else { b.low };
                    p_w[u] = b.low[u] + (i as f64 + 0.5) * size[u] / steps(u) as f64;
                    p_w[v] = b.low[v] + (j as f64 + 0.5) * size[v] / steps(v) as f64;
                    let past = p_w + 0.004 * n_w;
                    let is_inside = |c: &Block| past.cmpgt(c.low).all() && past.cmplt(c.high).all();
                    let Some(key) = key_of(p_w, cell) else { continue };
                    if blocks.iter().any(is_inside) || is_hidden(p_w) {
                        continue;
                    }
                    // Shading and a pattern without edges.
                    let shade = 1.0 + 0.08 * n_w.x as f32 + 0.05 * ((i / 2 + j / 2) % 2) as f32;
                    let color = b.color.map(|c| c * shade);
                    let none = Surfel {
                        p_w: DVec3::ZERO,
                        n_w: DVec3::ZERO,
                        weight: 0.0,
                        color: [0.0; 3],
                        sigma_m: 0.001,
                    };
                    let (sum, _) = found.entry(key).or_insert((none, b.body));
                    sum.p_w += p_w;
                    sum.n_w += n_w;
                    sum.weight += 1.0;
                    sum.color.iter_mut().zip(color).for_each(|(sum, c)| *sum += c);
                }
            }
        }
        for (sum, _) in found.values_mut() {
            sum.p_w /= sum.weight;
            sum.n_w = sum.n_w.normalize_or(DVec3::Z);
            sum.color = sum.color.map(|c| c / sum.weight as f32);
        }
        let keys: Vec<u64> = found.keys().copied().collect();
        let (surfels, body): (Vec<Surfel>, Vec<usize>) = found.into_values().unzip();
        let positions: Vec<DVec3> = surfels.iter().map(|s| s.p_w).collect();
        let graph = Neighbors::new(&keys, &positions, config.gap_m, cell);
        Self { surfels, graph, body, config }
    }

    fn all_of(blocks: &[Block]) -> Self {
        Self::of(blocks, |_| false)
    }

    /// Returns the bodies larger than crumbs: for each, the true body with the largest share of it, and that share.
    fn bodies(&self) -> Vec<(usize, f64)> {
        let all: Vec<usize> = (0..self.surfels.len()).collect();
        let mut found: Vec<(usize, f64)> = bodies(&self.surfels, &self.graph, &all, &self.config)
            .into_iter()
            .filter(|m| m.len() > 60)
            .map(|m| {
                let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
                m.iter().for_each(|&i| *counts.entry(self.body[i]).or_default() += 1);
                let (&body, &most) = counts.iter().max_by_key(|c| *c.1).unwrap();
                (body, most as f64 / m.len() as f64)
            })
            .collect();
        found.sort_by_key(|f| f.0);
        found
    }

    /// Asserts that these bodies are found, each once and nearly pure.
    fn assert_bodies(&self, expected: &[usize]) {
        let found = self.bodies();
        assert_eq!(found.iter().map(|f| f.0).collect::<Vec<_>>(), expected, "{found:.2?}");
        assert!(found.iter().all(|f| f.1 > 0.97), "{found:.2?}");
    }

    fn seams(&self) -> Vec<LevelSeam> {
        let all: Vec<usize> = (0..self.surfels.len()).collect();
        level_seams(&self.surfels, &all, self.config.voxel_m)
    }

    /// Returns the free-standing assemblies on the ground at z = 0, as surfels.
    fn free_standing(&self, is_static: impl Fn(&Surfel) -> bool) -> Vec<Vec<usize>> {
        let (coarse, graph, parent) = coarsen(&self.surfels, 3.0 * self.config.voxel_m);
        let heights: Vec<f64> = coarse.iter().map(|s| s.p_w.z).collect();
        let is_ground: Vec<bool> = heights.iter().map(|h| *h < 0.015).collect();
        let is_static: Vec<bool> = coarse.iter().map(is_static).collect();
        let found = free_standing(&coarse, &graph, &heights, &is_ground, &is_static, &self.config);
        let surfels_of = |cells: &Vec<usize>| {
            let within = |i: &usize| cells.binary_search(&(parent[*i] as usize)).is_ok();
            (0..self.surfels.len()).filter(within).collect()
        };
        found.iter().map(surfels_of).collect()
    }
}

#[test]
fn a_table_and_the_box_on_it_are_two_bodies() {
    let mut blocks = table(0, [0.25, 0.18], 0.3, 0.02, 0.036);
    blocks.push(block(1, BLUE, [-0.1, -0.12, 0.3], [0.3, 0.12, 0.42]));
    Cloud::all_of(&blocks).assert_bodies(&[0, 1]);
    // In one colour, there is still a level inward crease all around.
    blocks[5].color = WOOD;
    blocks[5].high.x = 0.2;
    Cloud::all_of(&blocks).assert_bodies(&[0, 1]);
}

#[test]
fn boxes_side_by_side_are_as_many_bodies_as_they_have_colours() {
    let mut blocks = [
        block(0, BLUE, [0.0, 0.0, 0.0], [0.2, 0.2, 0.4]),
        // The block is set back, so that there is a crease.
        block(1, WOOD, [0.2, 0.03, 0.0], [0.4, 0.17, 0.3]),
    ];
    Cloud::all_of(&blocks).assert_bodies(&[0, 1]);
    // In one colour, the two look like a cupboard with a step.
    blocks[1].color = BLUE;
    assert_eq!(Cloud::all_of(&blocks).bodies().len(), 1);
}

#[test]
fn a_ladder_is_one_body_with_its_rungs() {
    let mut blocks = vec![
        block(0, GREEN, [-0.2, -0.02, 0.0], [-0.16, 0.02, 0.7]),
        block(0, GREEN, [0.16, -0.02, 0.0], [0.2, 0.02, 0.7]),
    ];
    for z in [0.15, 0.35, 0.55] {
        blocks.push(block(0, WOOD, [-0.16, -0.015, z], [0.16, 0.015, z + 0.03]));
    }
    Cloud::all_of(&blocks).assert_bodies(&[0]);
}

#[test]
fn a_board_on_a_bin_and_ballast_on_the_board_are_three_bodies() {
    let blocks = [
        block(0, GREEN, [-0.13, -0.11, 0.0], [0.13, 0.11, 0.4]),
        block(1, WOOD, [-0.15, -0.09, 0.4], [0.5, 0.09, 0.43]),
        block(2, [90.0, 90.0, 95.0], [-0.12, -0.05, 0.43], [0.02, 0.05, 0.5]),
    ];
    Cloud::all_of(&blocks).assert_bodies(&[0, 1, 2]);
}

#[test]
fn a_board_over_a_rim_that_shows_in_pieces_lies_on_it() {
    let mut blocks = [
        block(0, GREEN, [-0.13, -0.11, 0.0], [0.13, 0.11, 0.4]),
        block(1, BLUE, [-0.13, -0.11, 0.4], [0.5, 0.11, 0.43]),
    ];
    // Two sides are visible, one of them partly hidden (shaded by the board).
    let is_hidden = |p: DVec3| (0.3..0.4).contains(&p.z) && (p.y > 0.0 || (-0.02..0.09).contains(&p.x));
    Cloud::of(&blocks, is_hidden).assert_bodies(&[0, 1]);
    // In one colour, the board may be a table top on its legs.
    blocks[0].color = BLUE;
    assert_eq!(Cloud::of(&blocks, is_hidden).bodies().len(), 1);
}

#[test]
fn a_rim_in_the_shade_is_part_of_its_bin() {
    let blocks = [
        block(0, GREEN, [-0.22, -0.17, 0.0], [0.22, 0.17, 0.372]),
        block(0, GREEN.map(|c| 0.45 * c), [-0.2, -0.15, 0.372], [0.2, 0.15, 0.396]),
        block(1, WOOD, [-0.18, -0.13, 0.396], [0.5, 0.13, 0.42]),
    ];
    let is_hidden = |p: DVec3| (0.372..0.397).contains(&p.z) && p.x > -0.17 && p.y > -0.12;
    let cloud = Cloud::of(&blocks, is_hidden);
    cloud.assert_bodies(&[0, 1]);
    let strip = (0..cloud.body.len()).filter(|&i| (0.376..0.392).contains(&cloud.surfels[i].p_w.z));
    let all: Vec<usize> = (0..cloud.body.len()).collect();
    let found = bodies(&cloud.surfels, &cloud.graph, &all, &cloud.config);
    let bin = found.iter().find(|m| cloud.body[m[0]] == 0 && m.len() > 60).unwrap();
    assert!(strip.clone().count() > 200 && strip.clone().all(|i| bin.contains(&i)));
}

/// A stool under a thin board that juts out far. Their sides are flush, and the seat is visible at the back.
fn board_on_stool(board: [f32; 3]) -> Vec<Block> {
    let mut blocks = table(0, [0.18, 0.18], 0.6, 0.02, 0.036);
    blocks.push(block(1, board, [-0.15, -0.18, 0.6], [0.7, 0.18, 0.612]));
    blocks
}

#[test]
fn a_board_flush_with_a_stool_is_separated_by_its_hue() {
    // Wood of slightly darker colour: the hue steps everywhere along the sides.
    Cloud::all_of(&board_on_stool([205.0, 150.0, 92.0])).assert_bodies(&[0, 1]);
    // In one colour, a ledge on one side of four is not enough: a table top that juts out over its stand has one, too.
    assert_eq!(Cloud::all_of(&board_on_stool(WOOD)).bodies().len(), 1);
}

#[test]
fn a_board_of_its_stools_colour_is_separated_by_three_ledges() {
    let mut blocks = board_on_stool(WOOD);
    (blocks[5].low.y, blocks[5].high.y) = (-0.16, 0.16);
    let cloud = Cloud::all_of(&blocks);
    cloud.assert_bodies(&[0, 1]);
    // Surfels above a seam must be classified as above: a board is only about three of them thick.
    let all: Vec<usize> = (0..cloud.body.len()).collect();
    let found = bodies(&cloud.surfels, &cloud.graph, &all, &cloud.config);
    let board = found.iter().find(|m| m.len() > 60 && cloud.body[m[0]] == 1).unwrap();
    let sides = (0..cloud.body.len()).filter(|&i| cloud.body[i] == 1 && cloud.surfels[i].n_w.z < 0.2);
    assert!(sides.clone().count() > 500 && sides.clone().all(|i| board.contains(&i)));
}

#[test]
fn a_top_with_a_lip_does_not_come_off() {
    // A counter on a plinth of another wood juts out by less than a lip.
    let blocks = [
        block(0, WOOD, [-0.25, -0.2, 0.0], [0.25, 0.2, 0.5]),
        block(0, [205.0, 150.0, 92.0], [-0.25, -0.2, 0.5], [0.3, 0.2, 0.54]),
    ];
    assert!(Cloud::all_of(&blocks).seams().is_empty());
    let juts = block(0, blocks[1].color, [-0.25, -0.2, 0.5], [0.5, 0.2, 0.54]);
    let cloud = Cloud::all_of(&[blocks[0], juts]);
    let [seam] = &cloud.seams()[..] else { panic!("{:?}", cloud.seams()) };
    assert!((seam.height_m - 0.5).abs() < 0.003, "{}", seam.height_m);
}

#[test]
fn a_tall_rim_in_the_shade_is_part_of_its_bin() {
    let blocks = [
        block(0, GREEN, [-0.22, -0.17, 0.0], [0.22, 0.17, 0.36]),
        block(0, GREEN.map(|c| 0.45 * c), [-0.2, -0.15, 0.36], [0.2, 0.15, 0.4]),
        block(1, WOOD, [-0.18, -0.13, 0.4], [0.6, 0.13, 0.424]),
    ];
    Cloud::all_of(&blocks).assert_bodies(&[0, 1]);
}

#[test]
fn floating_segments_join_their_neighbour() {
    // A sign of another colour on the side of a crate.
    let blocks = [
        block(0, BLUE, [-0.2, -0.2, 0.0], [0.2, 0.2, 0.5]),
        block(0, [230.0, 230.0, 230.0], [0.2, -0.1, 0.25], [0.24, 0.1, 0.4]),
    ];
    Cloud::all_of(&blocks).assert_bodies(&[0]);
}

/// A table under a tote that juts out over one side. The tote hides the upper ends of all legs and most of the top.
fn hidden_table() -> Cloud {
    let mut blocks = table(0, [0.25, 0.18], 0.3, 0.02, 0.036);
    blocks.push(block(1, BLUE, [-0.21, -0.17, 0.3], [0.33, 0.17, 0.44]));
    Cloud::of(&blocks, |p| (0.2..0.276).contains(&p.z))
}

#[test]
fn legs_whose_ends_are_hidden_join_the_lowest_thing_over_them() {
    let cloud = hidden_table();
    // The tote, the rim of the top, and each leg, as segmentation returns them.
    let is_leg = |i: usize| cloud.surfels[i].p_w.z < 0.2;
    let mut objects: Vec<Vec<usize>> =
        [1, 0].map(|b| (0..cloud.body.len()).filter(|&i| cloud.body[i] == b && !is_leg(i)).collect()).into();
    objects.extend(cloud.graph.components(is_leg));
    assert_eq!(objects.len(), 6);
    let joined = join_legs(&cloud.surfels, objects.clone(), |_| false);
    assert_eq!(joined.len(), 2);
    for members in joined {
        assert!(members.iter().all(|&i| cloud.body[i] == cloud.body[members[0]]));
    }
    // If cameras see through the gap, the posts are separate objects: bottles under the table.
    assert_eq!(join_legs(&cloud.surfels, objects, |_| true).len(), 6);
}

#[test]
fn legs_whose_ends_are_hidden_are_one_body_with_the_lowest_thing_over_them() {
    hidden_table().assert_bodies(&[0, 1]);
}

#[test]
fn walls_and_one_sided_views_do_not_stand_free() {
    let wall = Cloud::all_of(&[block(0, WOOD, [-0.3, 0.0, 0.0], [0.3, 0.03, 0.5])]);
    assert!(wall.free_standing(|_| false).is_empty(), "thin");
    let cupboard = [block(0, WOOD, [-0.25, -0.2, 0.0], [0.25, 0.2, 0.5])];
    assert_eq!(Cloud::all_of(&cupboard).free_standing(|_| false).len(), 1);
    let front = Cloud::of(&cupboard, |p| p.y > -0.199 && p.z < 0.499);
    assert!(front.free_standing(|_| false).is_empty(), "seen from one side");
    // Low assemblies are objects on a table, unless one of their faces was classified as static.
    let low = Cloud::all_of(&[block(0, WOOD, [-0.25, -0.2, 0.0], [0.25, 0.2, 0.2])]);
    assert!(low.free_standing(|_| false).is_empty(), "low");
    assert_eq!(low.free_standing(|s| s.n_w.z > 0.9).len(), 1);
}
