//! Questions about pipelines and their runs, with typed answers: what a plan costs, why an action runs, what a node
//! made, how far a run is, what the cache holds of a pipeline. The command line prints the answers; other front ends
//! read the same.
//!
//! Prints nothing, and runs nothing.

mod estimate;
mod explanation;
mod exposures;
mod family;
mod made;
mod plan;
mod reached;
mod reading;
mod run_state;

pub use explanation::{Explained, ExplainedGroup, Explanation, Why, explain, there_is};
pub use exposures::Exposures;
pub use family::Family;
pub use made::{Selection, SelectionError};
pub use plan::{Cost, NodePlan, PlanCosts, expected, plan};
pub use reached::{Reached, reached};
pub use reading::Reading;
pub use run_state::{Counts, Expected, LongAction, NodeState, Overall, RunState};
