//! The nodes of a run, by name, node-ID and part.

/// A node of a run.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Node {
    /// Its name.
    pub name: String,
    /// Its node-ID; 0 of canrig's own node.
    pub id: u8,
    /// Its part in the run.
    pub part: Part,
}

/// The part of a node in a run.
#[derive(Clone, Copy, Debug, Eq, Ord, PartialEq, PartialOrd)]
pub enum Part {
    /// The manager.
    Controller,
    /// A drive.
    Drive,
    /// A node with outputs that act on a plant.
    Io,
    /// canrig's own node, which can stop the drives.
    Bench,
}

impl Node {
    /// A node.
    #[must_use]
    pub fn new(name: &str, id: u8, part: Part) -> Self {
        Self {
            name: name.to_owned(),
            id,
            part,
        }
    }
}
