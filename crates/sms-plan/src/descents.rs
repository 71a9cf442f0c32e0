//! Many simplex searches: from the best screened points, with equal budgets or successive halving, or from the
//! paper's random simplexes.

use crate::screening::{self, Feasible, Screened};
use crate::space::Space;
use crate::{BatchOptimiser, LocalSearch, NelderMead, PlanError, Proposal, StartRecord, TrialPhase};
use rand::RngExt;
use rayon::prelude::*;
use sms_core::Seed;

/// Allocation of the budget to the searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sharing {
    /// The same number of evaluations for each.
    Even,
    /// Few evaluations for all, more for the better half, and so on until this many searches are left (successive
    /// halving, Jamieson and Talwalkar 2016).
    Halving(usize),
}

/// Settings of [`Descents`].
#[derive(Debug, Clone)]
pub(crate) struct DescentSettings {
    pub(crate) nelder_mead: NelderMead,
    pub(crate) initial_step: f64,
    pub(crate) starts: usize,
    pub(crate) sharing: Sharing,
}

struct Member {
    search: LocalSearch,
    initial: Vec<f64>,
    initial_objective: Option<f64>,
    /// Evaluations left in this round.
    allowance: usize,
    /// Number of infeasible points drawn for its start.
    passed_over: usize,
}

/// Number of draws for the first point of a random simplex (in the promising ranges, and again in the whole box) and
/// for each other point. When all draws are infeasible, the search moves the point towards the first one.
const FIRST_DRAWS: usize = 64;
const NEXT_DRAWS: usize = 16;

/// A random simplex: its points, whether the first is feasible, and the number of infeasible draws.
struct Drawn {
    points: Vec<Vec<f64>>,
    can: bool,
    passed_over: usize,
}

pub(crate) struct Descents {
    settings: DescentSettings,
    space: Space,
    /// Screened points; empty for random starts.
    screen: Vec<Screened>,
    screened: bool,
    members: Vec<Member>,
    /// Members of this round, best first.
    active: Vec<usize>,
    rounds_left: usize,
    /// The member that proposed each point.
    asked: Vec<usize>,
}

impl Descents {
    /// Creates searches from the best screened points.
    pub(crate) fn screened(space: &Space, settings: DescentSettings, screen: Vec<Screened>) -> Self {
        Self {
            settings,
            space: space.clone(),
            screen,
            screened: false,
            members: Vec::new(),
            active: Vec::new(),
            rounds_left: 0,
            asked: Vec::new(),
        }
    }

    /// Creates the paper's starts: simplexes of random points in the promising ranges, feasible ones where possible.
    pub(crate) fn random(
        space: &Space,
        settings: DescentSettings,
        seed: Seed,
        feasible: Feasible<'_>,
    ) -> Result<Self, PlanError> {
        let drawn: Vec<Drawn> = (0..settings.starts)
            .into_par_iter()
            .map(|i| random_simplex(space, seed.derive_index("simplex", i as u64), feasible))
            .collect::<Result<_, _>>()?;
        let mut descents = Self::screened(space, settings, Vec::new());
        descents.screened = true;
        let steps = space.steps(descents.settings.initial_step, true);
        let starts: Vec<_> = drawn.iter().map(|d| (d.points.clone(), steps.clone(), None)).collect();
        descents.begin(&starts);
        for (m, d) in descents.members.iter_mut().zip(drawn) {
            m.allowance = usize::MAX;
            m.passed_over = d.passed_over;
            if !d.can {
                m.search.end();
            }
        }
        descents.rounds_left = 0;
        Ok(descents)
    }

    fn begin(&mut self, starts: &[(Vec<Vec<f64>>, Vec<f64>, Option<f64>)]) {
        let nelder_mead = &self.settings.nelder_mead;
        self.members = starts
            .iter()
            .map(|(points, steps, known)| Member {
                search: LocalSearch::new(nelder_mead, points, steps, *known),
                initial: points[0].clone(),
                initial_objective: *known,
                allowance: 0,
                passed_over: 0,
            })
            .collect();
        self.active = (0..self.members.len()).collect();
        self.rounds_left = match self.settings.sharing {
            Sharing::Even => 1,
            Sharing::Halving(survivors) => {
                let mut rounds = 1;
                let mut count = self.members.len();
                while count > survivors.max(1) {
                    count = count.div_ceil(2).max(survivors.max(1));
                    rounds += 1;
                }
                rounds
            }
        };
    }

    fn begin_from_screen(&mut self) {
        let chosen =
            screening::distinct(&self.space, &self.screen, self.settings.initial_step, self.settings.starts);
        let starts: Vec<_> =
            chosen.into_iter().map(|(s, steps)| (vec![s.x], steps, Some(s.objective))).collect();
        self.begin(&starts);
    }

    /// Drops the worse half of the searches and shares the budget of this round. Returns whether there is a round.
    fn begin_round(&mut self, room: usize, first: bool) -> bool {
        if self.rounds_left == 0 {
            // If the last rounds left some budget, stopped searches continue, the best one first.
            let mut waiting: Vec<usize> =
                (0..self.members.len()).filter(|&i| self.members[i].search.next_point().is_some()).collect();
            waiting.sort_by(|&a, &b| self.value(a).total_cmp(&self.value(b)));
            waiting.truncate(4);
            let count = waiting.len();
            for (k, &i) in waiting.iter().enumerate() {
                self.members[i].allowance = room / count + usize::from(k < room % count);
            }
            self.active = waiting;
            return self.settings.sharing != Sharing::Even && count > 0;
        }
        if let Sharing::Halving(survivors) = self.settings.sharing
            && !first
        {
            let mut order = std::mem::take(&mut self.active);
            order.sort_by(|&a, &b| self.value(a).total_cmp(&self.value(b)));
            order.truncate(order.len().div_ceil(2).max(survivors.max(1)));
            self.active = order;
        }
        let share = room / self.rounds_left;
        let running: Vec<usize> =
            self.active.iter().copied().filter(|&i| self.members[i].search.next_point().is_some()).collect();
        for (k, &i) in running.iter().enumerate() {
            self.members[i].allowance = share / running.len() + usize::from(k < share % running.len());
        }
        self.rounds_left -= 1;
        true
    }

    fn value(&self, member: usize) -> f64 {
        self.members[member].search.minimum().objective
    }

    fn ask_members(&mut self, room: usize) -> Vec<Proposal> {
        self.asked.clear();
        let mut points = Vec::new();
        for &i in &self.active {
            let m = &mut self.members[i];
            if points.len() == room || m.allowance == 0 {
                continue;
            }
            if let Some(x) = m.search.next_point() {
                points.push(Proposal { x: x.to_vec(), phase: TrialPhase::Search, start: i as i32 });
                m.allowance = m.allowance.saturating_sub(1);
                self.asked.push(i);
            }
        }
        points
    }
}

/// Draws the n + 1 points of a random simplex, each until it is feasible.
fn random_simplex(space: &Space, seed: Seed, feasible: Feasible<'_>) -> Result<Drawn, PlanError> {
    let n = space.dimensions();
    let mut rng = seed.rng();
    let mut drawn = Drawn { points: Vec::new(), can: false, passed_over: 0 };
    for k in 0..=n {
        let most = if k == 0 { 2 * FIRST_DRAWS } else { NEXT_DRAWS };
        for draw in 1..=most {
            let unit: Vec<f64> = (0..n).map(|_| rng.random()).collect();
            let x = if k == 0 && draw > FIRST_DRAWS { unit } else { space.in_promising(&unit) };
            let can = feasible(&x)?;
            drawn.passed_over += usize::from(!can);
            if can || draw == most {
                drawn.can |= can && k == 0;
                drawn.points.push(x);
                break;
            }
        }
        if !drawn.can {
            // A search needs a feasible first point.
            drawn.points.resize(n + 1, drawn.points[0].clone());
            break;
        }
    }
    Ok(drawn)
}

impl BatchOptimiser for Descents {
    fn ask(&mut self, room: usize) -> Vec<Proposal> {
        if !self.screened {
            self.screen.truncate(room);
            return self
                .screen
                .iter()
                .map(|s| Proposal { x: s.x.clone(), phase: TrialPhase::Screen, start: -1 })
                .collect();
        }
        let mut first = self.members.is_empty();
        if first {
            self.begin_from_screen();
        }
        loop {
            let points = self.ask_members(room);
            if !points.is_empty() || !self.begin_round(room, first) {
                return points;
            }
            first = false;
        }
    }

    fn tell(&mut self, values: &[Option<f64>]) {
        if !self.screened {
            self.screen.iter_mut().zip(values).for_each(|(s, f)| s.objective = f.unwrap_or(f64::INFINITY));
            self.screened = true;
            return;
        }
        for (&i, value) in self.asked.iter().zip(values) {
            let m = &mut self.members[i];
            match value {
                Some(f) => {
                    m.initial_objective.get_or_insert(*f);
                    m.search.tell(*f);
                }
                None => {
                    // An infeasible point is not an evaluation.
                    m.allowance = m.allowance.saturating_add(1);
                    m.search.refuse();
                }
            }
        }
    }

    fn starts(&self) -> Vec<StartRecord> {
        self.members
            .iter()
            .map(|m| {
                let found = m.search.minimum();
                StartRecord {
                    initial: m.initial.clone(),
                    initial_objective: m.initial_objective.unwrap_or(found.objective),
                    found,
                    refused: m.passed_over + m.search.refused(),
                }
            })
            .collect()
    }
}
