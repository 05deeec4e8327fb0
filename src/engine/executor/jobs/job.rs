//! A job, its actions, and what it tells.

use super::{
    folder::{Folder, Lines},
    queue::Stage,
};
use crate::engine::{
    batch::{End, Line},
    executor::Order,
    request::LaneName,
};
use std::{cell::RefCell, rc::Rc, time::Instant};
use tauflow_cache::Key;

/// An action without a reply.
pub struct Open {
    pub order: Order,
    pub label: LaneName,
    /// The batch it came in.
    pub batch: u64,
    /// How often a job ended before it was done.
    pub attempts: u32,
}

/// A job that has not ended.
pub struct Job {
    pub folder: Rc<RefCell<Folder>>,
    pub number: usize,
    pub id: String,
    pub lines: Lines,
    /// By place: the action, unless it has a reply or nobody asked for it yet.
    pub orders: Vec<Option<Open>>,
    /// The place that it is at.
    pub at: usize,
    pub begun: bool,
    /// What kept it from going on.
    pub trouble: Option<String>,
    pub stage: Stage,
    /// Questions in which the scheduler did not name it.
    pub missed: u32,
    /// It measures.
    pub alone: bool,
}

impl Job {
    /// A job that was submitted.
    pub fn new(folder: &Rc<RefCell<Folder>>, number: usize, id: String, orders: Vec<Option<Open>>) -> Self {
        let lines = folder.borrow().lines(number);
        folder.borrow_mut().open += 1;
        Self {
            folder: folder.clone(),
            number,
            id,
            lines,
            orders,
            at: 0,
            begun: false,
            trouble: None,
            stage: Stage::Queued,
            missed: 0,
            alone: false,
        }
    }

    /// Takes note of a line. True if the action that it was at has come to its end; one that was stopped has not.
    pub fn hear(&mut self, line: &Line) -> bool {
        match line {
            Line::Begun { action } if *action == self.at => self.begun = true,
            Line::Ended { action, end, .. } if *action == self.at => match end {
                End::Cancelled => self.trouble = Some("it was told to stop".into()),
                // A full disk of one machine is not the run's.
                End::Fatal(message) => self.trouble = Some(message.clone()),
                End::Hit | End::Ran { .. } | End::Failed(_) | End::Missing(_) => {
                    (self.at, self.begun) = (self.at + 1, false);
                    return true;
                }
            },
            Line::Machine { .. } | Line::Begun { .. } | Line::Progress { .. } | Line::Ended { .. } => {}
        }
        false
    }
}

/// An action whose job says that it is done, and whose record is not seen yet.
pub struct Unseen {
    pub open: Open,
    pub end: End,
    pub warning: Option<String>,
    pub spent_us: u64,
    pub recorded: Option<Key>,
    pub since: Instant,
}
