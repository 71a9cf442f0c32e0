//! Minimum s–t cut by Dinic's algorithm (1970), with integer capacities for exact, repeatable results.

/// A flow network; node 0 is the source, node 1 the sink.
pub(crate) struct FlowNetwork {
    /// Target node of arc `a`; its reverse is `a ^ 1`.
    to: Vec<u32>,
    capacity: Vec<i64>,
    next: Vec<u32>,
    first: Vec<u32>,
}

const END: u32 = u32::MAX;
const SOURCE: usize = 0;
const SINK: usize = 1;

impl FlowNetwork {
    /// Creates a network with `nodes` inner nodes, numbered from 0 in the methods below.
    pub(crate) fn new(nodes: usize) -> Self {
        Self { to: Vec::new(), capacity: Vec::new(), next: Vec::new(), first: vec![END; nodes + 2] }
    }

    fn arc(&mut self, from: usize, to: usize, forward: i64, backward: i64) {
        for (a, b, c) in [(from, to, forward), (to, from, backward)] {
            self.next.push(self.first[a]);
            self.first[a] = self.to.len() as u32;
            self.to.push(b as u32);
            self.capacity.push(c);
        }
    }

    /// Adds the cost of assigning `node` to the sink's side (positive `gain`) or to the source's side (negative).
    pub(crate) fn terminal(&mut self, node: usize, gain: i64) {
        if gain > 0 {
            self.arc(SOURCE, node + 2, gain, 0);
        } else if gain < 0 {
            self.arc(node + 2, SINK, -gain, 0);
        }
    }

    /// Adds the cost of separating two nodes.
    pub(crate) fn link(&mut self, a: usize, b: usize, cost: i64) {
        self.arc(a + 2, b + 2, cost, cost);
    }

    /// Returns the nodes on the source's side of a minimum cut.
    pub(crate) fn source_side(mut self) -> Vec<bool> {
        let n = self.first.len();
        let mut level = vec![0u32; n];
        loop {
            level.fill(0);
            level[SOURCE] = 1;
            let mut queue = vec![SOURCE];
            let mut at = 0;
            while at < queue.len() {
                let v = queue[at];
                at += 1;
                let mut arc = self.first[v];
                while arc != END {
                    let w = self.to[arc as usize] as usize;
                    if self.capacity[arc as usize] > 0 && level[w] == 0 {
                        level[w] = level[v] + 1;
                        queue.push(w);
                    }
                    arc = self.next[arc as usize];
                }
            }
            if level[SINK] == 0 {
                return level[2..].iter().map(|&l| l > 0).collect();
            }
            let mut current = self.first.clone();
            while self.augment(&level, &mut current) {}
        }
    }

    /// Pushes flow along one shortest path; returns `false` if none is left at these levels.
    fn augment(&mut self, level: &[u32], current: &mut [u32]) -> bool {
        let mut path: Vec<u32> = Vec::new();
        let mut v = SOURCE;
        loop {
            if v == SINK {
                let flow = path.iter().map(|&a| self.capacity[a as usize]).min().unwrap_or(0);
                for &a in &path {
                    self.capacity[a as usize] -= flow;
                    self.capacity[(a ^ 1) as usize] += flow;
                }
                return true;
            }
            let mut arc = current[v];
            while arc != END {
                let w = self.to[arc as usize] as usize;
                if self.capacity[arc as usize] > 0 && level[w] == level[v] + 1 {
                    break;
                }
                arc = self.next[arc as usize];
            }
            current[v] = arc;
            if arc != END {
                path.push(arc);
                v = self.to[arc as usize] as usize;
            } else {
                let Some(back) = path.pop() else { return false };
                v = self.to[(back ^ 1) as usize] as usize;
                current[v] = self.next[current[v] as usize];
            }
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
        fn cuts_are_minimal(seed in 0u64..2000, n in 1usize..9) {
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
            let best = (0..1usize << n).map(|bits| cost(&|i| bits >> i & 1 == 1)).min().unwrap();
            prop_assert_eq!(cost(&|i| found[i]), best);
        }
    }
}
