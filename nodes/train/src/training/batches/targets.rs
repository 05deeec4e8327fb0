//! Targets of noisy rungs: without the samples of the input, and without the bias that noise has after a curve.

/// The mean of the samples of `all` that are not in `some`; both are means with their sample counts, and `some` is
/// nested in `all`. Rounding gives no negative radiance.
pub(super) fn others(some: (f32, f32), all: (f32, f32)) -> f32 {
    let rest = (all.0 * all.1 - some.0 * some.1) / (all.1 - some.1);
    if all.0 >= 0.0 { rest.max(0.0) } else { rest }
}

/// An estimate of f at the expectation of a target, whose bias is of second order, and an estimate of its variance.
///
/// The rungs are those of the input, the second last, and the last, nested, each a mean with its sample count. The
/// target is the mean of the samples that the input lacks, or, if it is not `apart`, of all samples: then only those
/// that the input lacks are noise.
///
/// The bias of f(mean of n samples) is proportional to 1/n up to higher orders: weighted by their samples, two groups
/// have twice the bias of both together (the jackknife of Quenouille 1956). Groups with samples of the input would make
/// the correction depend on its noise. An input of the second-last rung leaves one group, no correction, and a
/// variance of 0.
pub(super) fn unbiased(rungs: [(f32, f32); 3], apart: bool, f: impl Fn(f32) -> f32) -> (f32, f32) {
    let [input, half, all] = rungs;
    let lacking = all.1 - input.1;
    let target = |rest: f32| if apart { rest } else { (input.1 * input.0 + lacking * rest) / all.1 };
    let whole = f(if apart { others(input, all) } else { all.0 });
    if half.1 <= input.1 {
        return (whole, 0.0);
    }
    let share = (half.1 - input.1) / lacking;
    let (first, second) = (f(target(others(input, half))), f(target(others(half, all))));
    let groups = share * first + (1.0 - share) * second;
    // Means of n and m samples differ with a variance of s (1/n + 1/m), and that of all has s/(n + m).
    (2.0 * whole - groups, share * (1.0 - share) * (first - second) * (first - second))
}
