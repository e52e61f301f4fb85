//! The controller: which step is switched next to bring the total reactive power to its target (PFC-11). Knows no
//! registers and no time.

use super::map::STEPS;

/// A switching counts as bringing the total closer from one var on, the last digit displayed: what is smaller is
/// rounding, and rounding must never make it hunt.
const CLOSER_MVAR: i64 = 1000;

/// Sums closer to each other than this are alike: they differ by the rounding of their parts.
const ALIKE_MVAR: i64 = 100;

/// A step that could be switched towards the target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Move {
    /// The step, 0 first.
    pub step: usize,
    /// How far its switching moves the total towards the target, in millivars, more than 0.
    pub effect_mvar: i64,
    /// How often it has been switched.
    pub switch_count: u32,
}

/// What the controller wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The steps to switch.
    pub steps: [bool; STEPS],
    /// The first of them.
    pub first: usize,
}

/// How far the total lies from its target, and what is good enough.
#[derive(Clone, Copy, Debug)]
struct Aim {
    /// The sum of effects that hits the target itself.
    ideal: i64,
    /// The least sum that leaves nothing that the reactors cannot absorb.
    low: i64,
    /// The greatest such sum.
    high: i64,
}

impl Aim {
    /// Distance from the target that a sum of effects leaves, after the reactors.
    fn distance(&self, sum: i64) -> i64 {
        (self.low - sum).max(sum - self.high).max(0)
    }
}

/// A sum of effects and the moves that make it up.
#[derive(Clone, Copy, Debug)]
struct Sum {
    total: i64,
    moves: u32,
}

impl Sum {
    fn with(&self, other: &Self) -> Self {
        Self { total: self.total + other.total, moves: self.moves | other.moves }
    }

    fn size(&self) -> u32 {
        self.moves.count_ones()
    }
}

/// The steps whose switching brings the total closest to the target. `error_mvar` is the total minus the target, without
/// the reactors; these can absorb `reach_mvar` of what is over-compensated. All moves lead towards the target, so that
/// each of the plan, in whatever order, brings the total closer. `None` where nothing would.
///
/// Of plans that end equally close the one that leaves the reactors least to do, then the one with the fewest switchings
/// is taken. The step with the greatest effect goes first; of steps with equal effect those switched least often.
pub fn plan(error_mvar: i64, reach_mvar: i64, moves: &[Move]) -> Option<Plan> {
    let ideal = error_mvar.saturating_abs();
    let aim = if error_mvar > 0 {
        Aim { ideal, low: ideal, high: ideal.saturating_add(reach_mvar) }
    } else {
        Aim { ideal, low: ideal - reach_mvar, high: ideal }
    };
    let idle = aim.distance(0);
    if idle < CLOSER_MVAR {
        return None;
    }
    // A sum beyond this ends no closer than nothing at all.
    let end = aim.high.saturating_add(idle);
    let mut moves: Vec<Move> =
        moves.iter().copied().filter(|one| (CLOSER_MVAR..end).contains(&one.effect_mvar)).collect();
    moves.sort_by_key(|one| (-one.effect_mvar, one.switch_count, one.step));
    let best = closest(&aim, end, &moves)?;
    if aim.distance(best.total) > idle - CLOSER_MVAR {
        return None;
    }
    take_turns(best, &moves)
}

/// The best sum, by two halves: every sum of one half meets the two sums of the other that bring it nearest the ideal.
fn closest(aim: &Aim, end: i64, moves: &[Move]) -> Option<Sum> {
    let middle = moves.len() / 2;
    let left = sums(moves, 0..middle, end);
    let right = sums(moves, middle..moves.len(), end);
    let mut nearest: Vec<Sum> = Vec::with_capacity(2 * left.len());
    let mut above = right.len();
    for mine in &left {
        while above > 0 && mine.total + right[above - 1].total >= aim.ideal {
            above -= 1;
        }
        let partners = right[above.saturating_sub(1)..(above + 1).min(right.len())].iter();
        nearest.extend(partners.map(|theirs| mine.with(theirs)));
    }
    keep_least(&mut nearest, |sum| aim.distance(sum.total));
    keep_least(&mut nearest, |sum| (sum.total - aim.ideal).abs());
    nearest.into_iter().min_by_key(Sum::size)
}

/// Keeps the sums whose measure is the least, or alike.
fn keep_least(sums: &mut Vec<Sum>, measure: impl Fn(&Sum) -> i64) {
    let least = sums.iter().map(&measure).min().unwrap_or(0);
    sums.retain(|sum| measure(sum) < least + ALIKE_MVAR);
}

/// All sums below `end` of some moves, ascending; of those that are alike the one of the fewest moves.
fn sums(moves: &[Move], range: std::ops::Range<usize>, end: i64) -> Vec<Sum> {
    let mut sums = vec![Sum { total: 0, moves: 0 }];
    for index in range {
        let one = Sum { total: moves[index].effect_mvar, moves: 1 << index };
        let more: Vec<Sum> = sums.iter().map(|sum| sum.with(&one)).take_while(|sum| sum.total < end).collect();
        sums = merged(&sums, &more);
    }
    sums
}

fn merged(a: &[Sum], b: &[Sum]) -> Vec<Sum> {
    let mut merged: Vec<Sum> = Vec::with_capacity(a.len() + b.len());
    let (mut a, mut b) = (a.iter().peekable(), b.iter().peekable());
    loop {
        let next = match (a.peek(), b.peek()) {
            (Some(x), Some(y)) if x.total > y.total => b.next(),
            (None, _) => b.next(),
            _ => a.next(),
        };
        let Some(next) = next else { return merged };
        match merged.last_mut().filter(|last| next.total - last.total < ALIKE_MVAR) {
            None => merged.push(*next),
            Some(last) if next.size() < last.size() => *last = *next,
            Some(_) => {}
        }
    }
}

/// The plan of a sum: of the moves with equal effect it takes those switched least often. The moves come sorted by
/// effect and count.
fn take_turns(sum: Sum, moves: &[Move]) -> Option<Plan> {
    let mut steps = [false; STEPS];
    let mut first = None;
    for (index, one) in moves.iter().enumerate() {
        let alike = |other: &&Move| other.effect_mvar == one.effect_mvar;
        let start = index - moves[..index].iter().rev().take_while(alike).count();
        let size = moves[start..].iter().take_while(alike).count();
        let wanted = (sum.moves >> start & ((1 << size) - 1)).count_ones() as usize;
        if index - start < wanted {
            steps[one.step] = true;
            first = first.or(Some(one.step));
        }
    }
    first.map(|first| Plan { steps, first })
}
