//! Tells that a training has gone wrong, at the step where it does.
//!
//! Predictions are weighted means of what is shown (`network/head.rs`), so that a loss stays within what the data hold.
//! Weights that have run away make a network that picks single pixels. Its loss is a few times that of a fresh one:
//! finite, and useless. The norm of the weights detects it.

use tauflow_contract::KindError;

/// Growth of the norm of all weights from which a training has diverged. Adam moves a weight by about the learning rate
/// in a step, and sound trainings make some times what they began with; at a thousand times, softmax and normalisation
/// pass no gradient on.
const GROWTH: f64 = 1000.0;

/// Largest norm of a gradient whose square is a number in single precision, as Adam's second moment holds it: beyond
/// it, weights would stand still for ever, with no loss telling so.
const STEEPEST: f64 = 1.8e19;

/// The remedy at the end of each message.
const REMEDY: &str = "lower `learning_rate` or `clip`";

/// The loss of a step at some learning rate, on targets up to `largest`.
///
/// # Errors
/// If it is no finite number.
pub(crate) fn loss(step: u64, rate: f64, loss: f64, largest: f32) -> Result<(), KindError> {
    if loss.is_finite() {
        return Ok(());
    }
    Err(KindError::Input(format!(
        "the loss is {loss} at step {step}, with a learning rate of {rate:.1e} and targets up to {largest:.1e}; \
        {REMEDY}, or use `space: log1p` with `loss: absolute` for bright data"
    )))
}

/// The norm of a step's gradient at some learning rate, which is cut to `clip`.
///
/// # Errors
/// If it, or its square once it is cut, is beyond single precision.
pub(crate) fn gradient(step: u64, rate: f64, loss: f64, norm: f64, clip: f64) -> Result<(), KindError> {
    if norm.is_finite() && norm.min(clip) <= STEEPEST {
        return Ok(());
    }
    Err(KindError::Input(format!(
        "the norm of the gradient is {norm:.1e} at step {step}, with a learning rate of {rate:.1e}, a loss of \
        {loss:.3e} and `clip` {clip:e}; {REMEDY}"
    )))
}

/// The norm of the weights after a step at some learning rate, beside that of the first ones.
///
/// # Errors
/// If they have run away.
pub(crate) fn weights(step: u64, norm: f64, first: f64, rate: f64) -> Result<(), KindError> {
    if norm <= GROWTH * first {
        return Ok(());
    }
    Err(KindError::Input(format!(
        "the training diverges: after step {step}, with a learning rate of {rate:.1e}, the weights are {:.0} times as \
        large as at the start, above the limit of {GROWTH:.0} times; {REMEDY}",
        norm / first
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_sort_is_told_with_its_step_and_what_to_change() {
        let told = [
            loss(3, 0.5, f64::INFINITY, 1e30),
            loss(3, 0.5, f64::NAN, 1e30),
            gradient(3, 0.5, 1.0, f64::NAN, 1.0),
            gradient(3, 0.5, 1.0, 1e28, 1e30),
            weights(3, 1001.0, 1.0, 0.5),
            weights(3, f64::NAN, 1.0, 0.5),
        ];
        for told in told {
            let told = told.expect_err("diverged").to_string();
            assert!(
                ["step 3", "learning rate of 5.0e-1", "`learning_rate` or `clip`"]
                    .iter()
                    .all(|part| told.contains(part)),
                "{told}"
            );
        }
    }

    #[test]
    fn what_can_go_on_does() {
        assert!(loss(1, 0.5, 1e30, 1e15).is_ok() && weights(1, 999.0, 1.0, 0.5).is_ok());
        // A clip makes a step of whatever the gradient is.
        assert!(gradient(1, 0.5, 1e30, 1e38, 1.0).is_ok() && gradient(1, 0.5, 1.0, 1e19, 1e30).is_ok());
    }
}
