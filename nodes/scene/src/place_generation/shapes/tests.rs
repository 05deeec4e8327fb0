//! Shapes: closed, outward, of the right size.

use super::*;
