//! Minimum s–t cut by two search trees (Boykov and Kolmogorov, "An Experimental Comparison of Min-Cut/Max-Flow Algorithms for Energy
//! Minimization in Vision", TPAMI 2004), with integer capacities for exact, repeatable results.
//!
//! Votes connect nearly every node with the source or the sink, so that most augmenting paths are a few arcs long.

use std::collections::VecDeque;

/// A flow network with symmetric links.
pub(crate) struct FlowNetwork {
    /// Cost of assigning a node to the sink's side (positive) or to the source's side (negative).
    gains: Vec<i64>,
    links: Vec<(u32, u32, i64)>,
}

impl FlowNetwork {
    /// Creates a network with `nodes` inner nodes, numbered from 0 in the methods below.
    pub(crate) fn new(nodes: usize) -> Self {
        Self { gains: vec![0; nodes], links: Vec::new() }
    }

    /// Adds the cost of assigning `node` to the sink's side (positive `gain`) or to the source's side (negative).
    pub(crate) fn terminal(&mut self, node: usize, gain: i64) {
        self.gains[node] += gain;
    }

    /// Adds the cost of separating two nodes.
    pub(crate) fn link(&mut self, a: usize, b: usize, cost: i64) {
        self.links.push((a as u32, b as u32, cost));
    }

    /// Returns the nodes on the source's side of a minimum cut; of several, the cut with the fewest such nodes.
    pub(crate) fn source_side(self) -> Vec<bool> {
        let mut search = Search::new(self);
        search.run();
        // All that the source reaches through arcs with capacity left.
        search.nodes.iter().map(|node| node.tree == Tree::Source).collect()
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Tree {
    Free,
    Source,
    Sink,
}

/// The link of a node to the root of its tree.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Parent {
    /// None: the node is free, or its parent was lost.
    Lost,
    /// The source or the sink itself.
    Terminal,
    /// The arc from the node to its parent.
    Arc(u32),
}

#[derive(Clone, Copy)]
struct Node {
    /// Capacity left from the source (positive) or to the sink (negative).
    left: i64,
    tree: Tree,
    parent: Parent,
    /// Arcs to the root, as found at `time`.
    distance: u32,
    time: u32,
    is_active: bool,
}

/// The search of augmenting paths. Arcs come in pairs: `a ^ 1` is the reverse of `a`.
struct Search {
    nodes: Vec<Node>,
    /// Target node and capacity left of each arc.
    to: Vec<u32>,
    left: Vec<i64>,
    /// The arcs from node i are `arcs[first[i]..first[i + 1]]`.
    first: Vec<u32>,
    arcs: Vec<u32>,
    active: VecDeque<u32>,
    orphans: VecDeque<u32>,
    time: u32,
}

impl Search {
    fn new(network: FlowNetwork) -> Self {
        let FlowNetwork { gains, links } = network;
        let mut first = vec![0u32; gains.len() + 1];
        for &(a, b, _) in &links {
            first[a as usize + 1] += 1;
            first[b as usize + 1] += 1;
        }
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let (mut to, mut left) = (Vec::with_capacity(2 * links.len()), Vec::with_capacity(2 * links.len()));
        let mut arcs = vec![0; 2 * links.len()];
        let mut next = first.clone();
        for &(a, b, cost) in &links {
            for (from, target) in [(a, b), (b, a)] {
                let slot = &mut next[from as usize];
                arcs[*slot as usize] = to.len() as u32;
                *slot += 1;
                to.push(target);
                left.push(cost);
            }
        }
        let node = |&left: &i64| {
            let tree = match left {
                1.. => Tree::Source,
                0 => Tree::Free,
                _ => Tree::Sink,
            };
            let parent = if left == 0 { Parent::Lost } else { Parent::Terminal };
            Node { left, tree, parent, distance: 1, time: 0, is_active: left != 0 }
        };
        let nodes: Vec<Node> = gains.iter().map(node).collect();
        let active = (0..nodes.len() as u32).filter(|&i| nodes[i as usize].is_active).collect();
        Self { nodes, to, left, first, arcs, active, orphans: VecDeque::new(), time: 0 }
    }

    fn run(&mut self) {
        while let Some(&node) = self.active.front() {
            let is_in_a_tree = self.nodes[node as usize].tree != Tree::Free;
            match if is_in_a_tree { self.grow(node) } else { None } {
                Some(between) => {
                    self.augment(between);
                    self.time += 1;
                    while let Some(orphan) = self.orphans.pop_front() {
                        self.adopt(orphan);
                    }
                }
                None => {
                    self.active.pop_front();
                    self.nodes[node as usize].is_active = false;
                }
            }
        }
    }

    fn arcs_of(&self, node: u32) -> std::ops::Range<usize> {
        self.first[node as usize] as usize..self.first[node as usize + 1] as usize
    }

    /// Returns the capacity left of an arc that leaves a node of `tree`, in the direction from the source to the sink.
    fn onwards(&self, arc: u32, tree: Tree) -> i64 {
        self.left[if tree == Tree::Source { arc } else { arc ^ 1 } as usize]
    }

    fn activate(&mut self, node: u32) {
        if !std::mem::replace(&mut self.nodes[node as usize].is_active, true) {
            self.active.push_back(node);
        }
    }

    /// Adds the free neighbours of a node to its tree. Returns an arc from the source's to the sink's tree when one is found.
    fn grow(&mut self, node: u32) -> Option<u32> {
        let Node { tree, distance, time, .. } = self.nodes[node as usize];
        for slot in self.arcs_of(node) {
            let arc = self.arcs[slot];
            if self.onwards(arc, tree) == 0 {
                continue;
            }
            let next = self.to[arc as usize];
            let other = &mut self.nodes[next as usize];
            let is_free = other.tree == Tree::Free;
            if is_free || (other.tree == tree && other.time <= time && other.distance > distance + 1) {
                other.tree = tree;
                other.parent = Parent::Arc(arc ^ 1);
                other.distance = distance + 1;
                other.time = time;
            } else if other.tree != tree {
                return Some(if tree == Tree::Source { arc } else { arc ^ 1 });
            }
            if is_free {
                self.activate(next);
            }
        }
        None
    }

    /// Pushes as much flow as possible along the path through an arc from the source's to the sink's tree.
    fn augment(&mut self, between: u32) {
        let ends = [self.to[(between ^ 1) as usize], self.to[between as usize]];
        let mut flow = self.left[between as usize];
        for end in ends {
            let mut node = end;
            while let Parent::Arc(arc) = self.nodes[node as usize].parent {
                flow = flow.min(self.onwards(arc ^ 1, self.nodes[node as usize].tree));
                node = self.to[arc as usize];
            }
            flow = flow.min(self.nodes[node as usize].left.abs());
        }
        self.push(between, flow);
        for end in ends {
            let mut node = end;
            let tree = self.nodes[node as usize].tree;
            while let Parent::Arc(arc) = self.nodes[node as usize].parent {
                self.push(if tree == Tree::Source { arc ^ 1 } else { arc }, flow);
                if self.onwards(arc ^ 1, tree) == 0 {
                    self.lose_parent(node);
                }
                node = self.to[arc as usize];
            }
            let root = &mut self.nodes[node as usize];
            root.left -= root.left.signum() * flow;
            if root.left == 0 {
                self.lose_parent(node);
            }
        }
    }

    fn push(&mut self, arc: u32, flow: i64) {
        self.left[arc as usize] -= flow;
        self.left[(arc ^ 1) as usize] += flow;
    }

    fn lose_parent(&mut self, node: u32) {
        self.nodes[node as usize].parent = Parent::Lost;
        self.orphans.push_back(node);
    }

    /// Finds a new parent for a node in its tree; without one, the node becomes free and its children lose their parent.
    fn adopt(&mut self, orphan: u32) {
        let tree = self.nodes[orphan as usize].tree;
        let mut best = None;
        for slot in self.arcs_of(orphan) {
            let arc = self.arcs[slot];
            let near = self.to[arc as usize];
            if self.nodes[near as usize].tree != tree || self.onwards(arc ^ 1, tree) == 0 {
                continue;
            }
            let Some(distance) = self.distance_to_root(near) else { continue };
            if best.is_none_or(|(least, _)| distance < least) {
                best = Some((distance, arc));
            }
        }
        if let Some((distance, arc)) = best {
            let time = self.time;
            let node = &mut self.nodes[orphan as usize];
            (node.parent, node.distance, node.time) = (Parent::Arc(arc), distance + 1, time);
            return;
        }
        self.nodes[orphan as usize].tree = Tree::Free;
        for slot in self.arcs_of(orphan) {
            let arc = self.arcs[slot];
            let near = self.to[arc as usize];
            let Node { tree: other, parent, .. } = self.nodes[near as usize];
            if other != tree {
                continue;
            }
            if self.onwards(arc ^ 1, tree) > 0 {
                self.activate(near);
            }
            if parent == Parent::Arc(arc ^ 1) {
                self.lose_parent(near);
            }
        }
    }

    /// Returns the number of arcs from a node to the root of its tree, or `None` if a parent on the way was lost.
    fn distance_to_root(&mut self, from: u32) -> Option<u32> {
        let (mut node, mut arcs) = (from, 0);
        let mut distance = loop {
            let Node { parent, distance, time, .. } = self.nodes[node as usize];
            if time == self.time && parent != Parent::Lost {
                break arcs + distance;
            }
            match parent {
                Parent::Lost => return None,
                Parent::Terminal => break arcs + 1,
                Parent::Arc(arc) => node = self.to[arc as usize],
            }
            arcs += 1;
        };
        let total = distance;
        // The way that was found is not walked again at this time.
        node = from;
        loop {
            let found = &mut self.nodes[node as usize];
            if found.time == self.time {
                return Some(total);
            }
            (found.time, found.distance) = (self.time, distance);
            let Parent::Arc(arc) = found.parent else { return Some(total) };
            distance -= 1;
            node = self.to[arc as usize];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::RngExt;

    proptest! {
        #[test]
        fn cuts_are_minimal_and_of_these_the_source_side_is_smallest(seed in 0u64..2000, n in 1usize..9) {
            let mut rng = sms_core::Seed(seed).rng();
            let gains: Vec<i64> = (0..n).map(|_| rng.random_range(-9..10)).collect();
            let mut links = Vec::new();
            let mut network = FlowNetwork::new(n);
            for (i, &g) in gains.iter().enumerate() {
                network.terminal(i, g);
                for j in 0..i {
                    let cost = rng.random_range(0..6i64);
                    network.link(i, j, cost);
                    links.push((i, j, cost));
                }
            }
            let cost = |side: &dyn Fn(usize) -> bool| -> i64 {
                let own: i64 =
                    gains.iter().enumerate().map(|(i, &g)| if side(i) { (-g).max(0) } else { g.max(0) }).sum();
                own + links.iter().map(|&(i, j, c)| if side(i) == side(j) { 0 } else { c }).sum::<i64>()
            };
            let found = network.source_side();
            let costs: Vec<i64> = (0..1usize << n).map(|bits| cost(&|i| bits >> i & 1 == 1)).collect();
            let least = costs.iter().min().unwrap();
            let in_all = (0..1usize << n).filter(|&bits| costs[bits] == *least).fold(usize::MAX, |a, b| a & b);
            prop_assert_eq!(found, (0..n).map(|i| in_all >> i & 1 == 1).collect::<Vec<_>>());
        }
    }

    /// A grid in three dimensions against the augmenting paths of Edmonds and Karp (1972).
    #[test]
    fn a_grid_is_cut_as_by_shortest_augmenting_paths() {
        for seed in 0..6 {
            let (side, mut rng) = (7, sms_core::Seed(seed).rng());
            let n = side * side * side;
            let gains: Vec<i64> = (0..n).map(|_| rng.random_range(-40..41)).collect();
            let mut links = Vec::new();
            for i in 0..n {
                let at = [i % side, i / side % side, i / side / side];
                for (axis, step) in [(0, 1), (1, side), (2, side * side)] {
                    if at[axis] + 1 < side {
                        links.push((i, i + step, rng.random_range(0..25i64)));
                    }
                }
            }
            let mut network = FlowNetwork::new(n);
            gains.iter().enumerate().for_each(|(i, &g)| network.terminal(i, g));
            links.iter().for_each(|&(a, b, cost)| network.link(a, b, cost));
            assert_eq!(network.source_side(), by_shortest_paths(&gains, &links), "{seed}");
        }
    }

    fn by_shortest_paths(gains: &[i64], links: &[(usize, usize, i64)]) -> Vec<bool> {
        let (source, sink) = (gains.len(), gains.len() + 1);
        let mut arcs: Vec<(usize, usize, i64)> = Vec::new();
        for (i, &g) in gains.iter().enumerate() {
            let (from, to) = if g > 0 { (source, i) } else { (i, sink) };
            arcs.extend([(from, to, g.abs()), (to, from, 0)]);
        }
        links.iter().for_each(|&(a, b, cost)| arcs.extend([(a, b, cost), (b, a, cost)]));
        loop {
            let mut by: Vec<Option<usize>> = vec![None; gains.len() + 2];
            let mut queue = VecDeque::from([source]);
            let is_reached = |by: &[Option<usize>], node: usize| node == source || by[node].is_some();
            while let Some(node) = queue.pop_front() {
                for (k, &(from, to, left)) in arcs.iter().enumerate() {
                    if from == node && left > 0 && !is_reached(&by, to) {
                        by[to] = Some(k);
                        queue.push_back(to);
                    }
                }
            }
            if by[sink].is_none() {
                return (0..gains.len()).map(|i| is_reached(&by, i)).collect();
            }
            let path: Vec<usize> = std::iter::successors(by[sink], |&k| by[arcs[k].0]).collect();
            let flow = path.iter().map(|&k| arcs[k].2).min().unwrap();
            for k in path {
                arcs[k].2 -= flow;
                arcs[k ^ 1].2 += flow;
            }
        }
    }
}
