//! The loop of a pass. It passes the scheduler's requests to the look-up threads, its batches to the executor, and the
//! answers of both back to the scheduler.
//!
//! It does not know how a request is answered: it reads and writes nothing itself.

use super::{
    EngineError, Sink,
    executor::{Executor, Reply},
    request::{Request, Response},
    scheduler::Scheduler,
};
use std::{
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    thread,
};

/// News that are taken before work is handed out again.
const AT_ONCE: usize = 256;

/// A message of another thread.
pub enum News {
    /// A request is answered.
    Answered(Response),
    /// An action was executed.
    Executed(Box<Reply>),
}

/// See the module.
pub struct Steering<'a> {
    /// Set when the run is to stop.
    pub stop: &'a AtomicBool,
    /// Nothing more is begun after a failure.
    pub fail_fast: bool,
    /// Takes events.
    pub sink: Sink<'a>,
    /// The executor; none in a run that only looks.
    pub executor: Option<&'a dyn Executor>,
    /// Answers a request, on a look-up thread.
    pub answer: &'a (dyn Fn(Request) -> Response + Sync),
    /// Number of look-up threads.
    pub workers: usize,
    /// Answers, and what the executor did.
    pub news: &'a mpsc::Receiver<News>,
    /// Where answers are sent.
    pub tell: &'a mpsc::Sender<News>,
}

impl Steering<'_> {
    /// Looks up and runs until nothing is left.
    ///
    /// # Errors
    /// If the store fails, or the executor does.
    pub fn work(&self, scheduler: &mut Scheduler<'_>) -> Result<(), EngineError> {
        let (seek, sought) = mpsc::channel::<Request>();
        let sought = Mutex::new(sought);
        thread::scope(|scope| {
            // Threads of their own for look-ups, so that none waits for an action that takes hours.
            for _ in 0..self.workers {
                let (tell, sought, answer) = (self.tell.clone(), &sought, self.answer);
                scope.spawn(move || {
                    let next = || sought.lock().unwrap_or_else(PoisonError::into_inner).recv();
                    while let Ok(request) = next() {
                        if tell.send(News::Answered(answer(request))).is_err() {
                            return;
                        }
                    }
                });
            }
            let result = self.steer(scheduler, &seek);
            drop(seek);
            result
        })
    }

    fn steer(&self, scheduler: &mut Scheduler<'_>, seek: &mpsc::Sender<Request>) -> Result<(), EngineError> {
        let take = |scheduler: &mut Scheduler<'_>, news: News| match news {
            News::Answered(answer) => scheduler.answered(answer),
            News::Executed(reply) => {
                if let Some(executor) = self.executor {
                    executor.settle(&reply);
                }
                scheduler.executed(*reply)
            }
        };
        loop {
            // The threads live as long as this loop does.
            let ask = |request| drop(seek.send(request));
            while let Some(request) = scheduler.next_keep() {
                ask(request);
            }
            scheduler.take_events().iter().for_each(self.sink);
            let failed = self.fail_fast && !scheduler.failures().is_empty();
            if !failed && !self.stop.load(Ordering::Relaxed) {
                // Two requests for each thread, so that none waits for the next.
                while scheduler.seeking() < 2 * self.workers
                    && let Some(request) = scheduler.next_request()
                {
                    ask(request);
                }
                if let Some(executor) = self.executor {
                    while let Some(batch) = scheduler.next_run(executor.capacity()) {
                        executor.submit(batch);
                    }
                }
            }
            if scheduler.running() + scheduler.seeking() == 0 {
                return Ok(());
            }
            let Ok(news) = self.news.recv() else { return Ok(()) };
            take(scheduler, news)?;
            self.news.try_iter().take(AT_ONCE).try_for_each(|news| take(scheduler, news))?;
        }
    }
}
