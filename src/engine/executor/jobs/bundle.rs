//! How actions are gathered into jobs: by the seconds that they are expected to take. Knows neither jobs nor actions.

use std::ops::Range;

/// A job of less than this costs more to start than it does.
const LEAST_S: f64 = 10.0;
/// Seconds that a job may take to start.
const STARTS_S: u64 = 60;
/// Actions of one job, at most.
const MOST_ACTIONS: usize = 4096;

/// The seconds that a job should take: all that is to be done, shared out over the jobs that may begin, but neither
/// more than `most_s` nor so little that starting jobs is most of the work.
pub fn duration(all_s: f64, free: usize, most_s: f64) -> f64 {
    (all_s / free.max(1) as f64).max(LEAST_S).min(most_s)
}

/// The time limit of a job in seconds, if its actions have one: that of one action, and three times what all are
/// expected to take, if there are several. Limits are for what goes wrong, which is seldom two actions of one job.
pub fn time_limit(of_one: Option<u64>, actions: usize, expected_s: f64) -> Option<u64> {
    let of_others = if actions > 1 { (3.0 * expected_s).ceil() as u64 } else { 0 };
    // Starting a job and opening a store take a while.
    of_one.map(|seconds| seconds.saturating_add(of_others).saturating_add(STARTS_S))
}

/// Divides actions, which are expected to take so many seconds each, into jobs of about `duration_s`.
pub fn bundles(seconds: &[f64], duration_s: f64) -> Vec<Range<usize>> {
    let (mut bundles, mut start, mut sum) = (Vec::new(), 0, 0.0);
    for (n, cost) in seconds.iter().enumerate() {
        // The next one goes in as long as the job comes closer to its duration by it.
        let full = n > start && (sum + cost / 2.0 > duration_s || n - start >= MOST_ACTIONS);
        if full {
            bundles.push(start..n);
            (start, sum) = (n, 0.0);
        }
        sum += cost;
    }
    if start < seconds.len() {
        bundles.push(start..seconds.len());
    }
    bundles
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_take_about_their_duration_and_long_actions_have_one_of_their_own() {
        assert_eq!(bundles(&[], 10.0), Vec::<Range<usize>>::new());
        assert_eq!(bundles(&[1.0; 25], 10.0), [0..10, 10..20, 20..25]);
        assert_eq!(bundles(&[100.0, 100.0, 1.0, 1.0], 10.0), [0..1, 1..2, 2..4]);
        assert_eq!(bundles(&[6.0, 6.0, 6.0], 10.0), [0..2, 2..3]);
        assert_eq!(bundles(&vec![0.0; MOST_ACTIONS + 1], 10.0), [0..MOST_ACTIONS, MOST_ACTIONS..MOST_ACTIONS + 1]);
    }

    #[test]
    fn jobs_have_a_time_limit_if_their_actions_have_one() {
        assert_eq!(time_limit(None, 5, 100.0), None);
        assert_eq!(time_limit(Some(3600), 1, 100.0), Some(3600 + STARTS_S));
        assert_eq!(time_limit(Some(3600), 5, 100.0), Some(3900 + STARTS_S));
    }

    #[test]
    fn work_is_shared_out_until_jobs_become_too_short() {
        assert_eq!(duration(1000.0, 10, 600.0), 100.0);
        assert_eq!(duration(1000.0, 1000, 600.0), LEAST_S);
        assert_eq!(duration(1e6, 10, 600.0), 600.0);
        assert_eq!(duration(0.0, 0, 2.0), 2.0, "what the user asks for is short enough");
    }
}
