//! What is asked of the look-up threads, by node. Knows nothing of what is ready.

/// See the module.
pub(super) struct Seeking {
    /// Requests without an answer, by node, and in all.
    by_node: Vec<usize>,
    all: usize,
}

impl Seeking {
    /// Nothing, of so many nodes.
    pub fn new(nodes: usize) -> Self {
        Self { by_node: vec![0; nodes], all: 0 }
    }

    /// Requests without an answer.
    pub fn requests(&self) -> usize {
        self.all
    }

    /// Something of a node is asked.
    pub fn begin(&mut self, node: usize) {
        self.by_node[node] += 1;
        self.all += 1;
    }

    /// It was answered.
    pub fn end(&mut self, node: usize) {
        self.by_node[node] -= 1;
        self.all -= 1;
    }

    /// Whether something of a node after this one is being looked up.
    pub fn after(&self, node: usize) -> bool {
        self.by_node[node + 1..].iter().any(|bundles| *bundles > 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn later_nodes_are_told_from_earlier_ones() {
        let mut seeking = Seeking::new(3);
        seeking.begin(1);
        assert!(seeking.after(0) && !seeking.after(1) && !seeking.after(2));
        seeking.end(1);
        assert!(!seeking.after(0) && seeking.requests() == 0);
    }
}
