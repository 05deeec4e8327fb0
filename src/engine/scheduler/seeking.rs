//! What is being looked up, by node. Knows nothing of what is ready.

/// See the module.
pub(super) struct Seeking {
    /// Bundles that are being looked up, by node, and in all.
    by_node: Vec<usize>,
    all: usize,
}

impl Seeking {
    /// Nothing, of so many nodes.
    pub fn new(nodes: usize) -> Self {
        Self { by_node: vec![0; nodes], all: 0 }
    }

    /// Bundles that are being looked up.
    pub fn bundles(&self) -> usize {
        self.all
    }

    /// A bundle of a node goes to be looked up.
    pub fn begin(&mut self, node: usize) {
        self.by_node[node] += 1;
        self.all += 1;
    }

    /// A bundle of a node was looked up.
    pub fn end(&mut self, node: usize) {
        self.by_node[node] -= 1;
        self.all -= 1;
    }

    /// Whether a node after this one is being looked up.
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
        assert!(!seeking.after(0) && seeking.bundles() == 0);
    }
}
