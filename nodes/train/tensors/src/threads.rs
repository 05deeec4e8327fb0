//! Threads for trainings that run side by side: each has its share of the processor, anew at every step, so that the
//! last of a matrix of trainings has all of it. The bits do not depend on it.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::atomic::{AtomicUsize, Ordering};
use tauflow_contract::KindError;

/// Trainings that run in this process.
static RUNNING: AtomicUsize = AtomicUsize::new(0);

/// One training's share of the processor.
pub struct Share {
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
        RUNNING.fetch_add(1, Ordering::Relaxed);
        Self { pool: None, most: 0 }
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
        let threads = (cores / RUNNING.load(Ordering::Relaxed).max(1)).max(1);
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
        RUNNING.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_given_back_even_by_a_panic() {
        // Other tests of this program train, too: theirs come and go.
        let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
        let mut share = Share::new();
        let threads = share.run(rayon::current_num_threads).expect("threads");
        assert!((1..=cores).contains(&threads) && share.most() == threads);
        let before = std::panic::catch_unwind(|| {
            let _share = Share::new();
            panic!("on purpose");
        });
        assert!(before.is_err());
        let many: Vec<Share> = (0..4 * cores).map(|_| Share::new()).collect();
        assert_eq!(share.run(rayon::current_num_threads).expect("threads"), 1);
        drop(many);
    }
}
