//! When the actions of a run took place, on as many tracks as actions ran at a time. Actions that are too short to be
//! seen are drawn as one bar with their neighbours, so that a run of a million actions has a timeline, too.

use crate::engine::event::Name;

/// Bars that are kept, at most.
const MOST_BARS: usize = 3000;

/// One action, or several short ones after each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// The node, of the longest action.
    pub node: Name,
    /// The cell, or empty.
    pub cell: Name,
    /// The item, or empty.
    pub item: Name,
    /// When it began, in seconds since the start of the run.
    pub from: f64,
    /// When it ended.
    pub to: f64,
    /// Number of actions.
    pub actions: u64,
    /// Whether any of them failed.
    pub failed: bool,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub struct Timeline {
    /// The bars by track, in the order in which they ended.
    pub tracks: Vec<Vec<Bar>>,
    /// Bars in all.
    bars: usize,
    /// Shorter bars than this are drawn with their neighbours, in seconds.
    finest: f64,
}

impl Bar {
    fn seconds(&self) -> f64 {
        self.to - self.from
    }

    /// Takes the next bar of its track in.
    fn take(&mut self, next: Self) {
        if next.seconds() > self.seconds() {
            (self.node, self.cell, self.item) = (next.node, next.cell, next.item);
        }
        self.to = self.to.max(next.to);
        self.actions += next.actions;
        self.failed |= next.failed;
    }

    /// Whether this and the next bar of its track are drawn as one.
    fn joins(&self, next: &Self, finest: f64, mixed: bool) -> bool {
        let short = self.seconds() < finest || next.seconds() < finest;
        short && next.from - self.to < finest && (mixed || self.node == next.node)
    }
}

impl Timeline {
    /// Adds the action that ended last on a track.
    pub fn push(&mut self, track: usize, bar: Bar) {
        if self.tracks.len() <= track {
            self.tracks.resize_with(track + 1, Vec::new);
        }
        let finest = self.finest;
        match self.tracks[track].last_mut() {
            Some(last) if last.joins(&bar, finest, false) => last.take(bar),
            _ => {
                self.tracks[track].push(bar);
                self.bars += 1;
            }
        }
        // Ends: bars that are shorter than the whole run are joined at last.
        let mut mixed = false;
        while self.bars > MOST_BARS {
            self.coarsen(mixed);
            mixed = true;
        }
    }

    fn coarsen(&mut self, mixed: bool) {
        self.finest = (self.finest * 2.0).max(0.001);
        for track in &mut self.tracks {
            let mut joined: Vec<Bar> = Vec::with_capacity(track.len());
            for bar in track.drain(..) {
                match joined.last_mut() {
                    Some(last) if last.joins(&bar, self.finest, mixed) => last.take(bar),
                    _ => joined.push(bar),
                }
            }
            *track = joined;
        }
        self.bars = self.tracks.iter().map(Vec::len).sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(node: &str, from: f64, to: f64) -> Bar {
        Bar { node: node.into(), cell: "".into(), item: "".into(), from, to, actions: 1, failed: false }
    }

    #[test]
    fn a_million_actions_keep_their_number_and_the_long_ones_their_place() {
        let mut timeline = Timeline::default();
        let mut at = 0.0;
        for number in 0..200_000 {
            let (node, seconds) = if number % 50_000 == 7 { ("long", 40.0) } else { ("short", 0.002) };
            timeline.push(number % 2, bar(node, at, at + seconds));
            at += seconds / 2.0;
        }
        let bars = || timeline.tracks.iter().flatten();
        assert!(timeline.tracks.len() == 2 && bars().count() <= MOST_BARS);
        assert_eq!(bars().map(|bar| bar.actions).sum::<u64>(), 200_000);
        assert_eq!(bars().filter(|bar| &*bar.node == "long").count(), 4);
    }
}
