//! Threads for trainings that run side by side: each has its share of the processor, anew at every step, so that the
//! last of a matrix of trainings has all of it. The bits do not depend on it.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use tauflow_contract::KindError;

/// Trainings that run in this process.
static RUNNING: AtomicUsize = AtomicUsize::new(0);

/// One training's share of the processor.
pub struct Share {
    /// How many trainings share the processor.
    running: &'static AtomicUsize,
    pool: Option<ThreadPool>,
    most: usize,
}

impl Default for Share {
    fn default() -> Self {
        Self::new()
    }
}

impl Share {
    /// A share, until it is dropped.
    pub fn new() -> Self {
        Self::of(&RUNNING)
    }

    fn of(running: &'static AtomicUsize) -> Self {
        running.fetch_add(1, Ordering::Relaxed);
        Self { running, pool: None, most: 0 }
    }

    /// The largest share that there was.
    pub fn most(&self) -> usize {
        self.most
    }

    /// Runs `f` on as many threads as are this training's now.
    ///
    /// # Errors
    /// If threads cannot be started.
    pub fn run<T: Send>(&mut self, f: impl FnOnce() -> T + Send) -> Result<T, KindError> {
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let threads = (cores / self.running.load(Ordering::Relaxed).max(1)).max(1);
        self.most = self.most.max(threads);
        let pool = match self.pool.take().filter(|pool| pool.current_num_threads() == threads) {
            Some(pool) => pool,
            None => ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .map_err(|e| KindError::Environment(format!("cannot start {threads} threads for training: {e}")))?,
        };
        Ok(self.pool.insert(pool).install(f))
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.running.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_given_back_even_by_a_panic() {
        // A count of its own, as other tests of this program train, too.
        static HERE: AtomicUsize = AtomicUsize::new(0);
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let mut share = Share::of(&HERE);
        let mut threads = || share.run(rayon::current_num_threads).expect("threads");
        assert_eq!(threads(), cores);
        let panicked = std::panic::catch_unwind(|| {
            let _share = Share::of(&HERE);
            assert_eq!(HERE.load(Ordering::Relaxed), 2);
            panic!("on purpose");
        });
        assert!(panicked.is_err());
        assert_eq!((HERE.load(Ordering::Relaxed), threads()), (1, cores));
        let many: Vec<Share> = (0..4 * cores).map(|_| Share::of(&HERE)).collect();
        assert_eq!(threads(), 1);
        drop(many);
        assert_eq!(threads(), cores);
        assert_eq!(share.most(), cores);
        drop(share);
        assert_eq!(HERE.load(Ordering::Relaxed), 0);
    }
}
