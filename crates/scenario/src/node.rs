//! The nodes of a run, by name, node-ID and part.

use std::borrow::Cow;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::rig::nodes::CONTROLLER_NODE_ID;

/// Node of a run.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct Node {
    /// Name of the node.
    pub name: String,
    /// Node-ID; 0 for canrig's own node.
    pub id: u8,
    /// Part of the node in the run.
    pub part: Part,
}

/// Kind of a node.
#[derive(
    Clone, Copy, Debug, Deserialize, Eq, JsonSchema, Ord, PartialEq, PartialOrd, Serialize,
)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "NodeKind")]
pub enum Part {
    /// SYNC producer, NMT master, and the laws of all loops. A bus has one.
    Controller,
    /// An emulated CiA 402 drive with amplifier and sensor.
    Drive,
    /// An emulated CiA 401 node with outputs that act on a plant, such as a fan and a load.
    Io,
    /// canrig's own node, which can stop the drives and is in no rig file.
    #[serde(skip)]
    Bench,
}

impl Part {
    /// Returns its word in rig files: `kind = "drive"`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Drive => "drive",
            Self::Io => "io",
            Self::Bench => "bench",
        }
    }
}

impl Node {
    /// Makes a node.
    pub fn new(name: &str, id: u8, part: Part) -> Self {
        Self {
            name: name.to_owned(),
            id,
            part,
        }
    }

    /// Returns its name within a sentence: `the drive` for a node with the name of its part, else the name.
    pub fn in_sentence(&self) -> Cow<'_, str> {
        if self.name == self.part.word() {
            format!("the {}", self.name).into()
        } else {
            self.name.as_str().into()
        }
    }
}

/// Nodes of a loop.
#[derive(Clone, Debug, Eq, PartialEq)]
pub struct LoopNodes {
    /// Controller, which leads all loops.
    pub controller: Node,
    /// Drive of the loop.
    pub drive: Node,
    /// Drive whose signal the loop follows: mostly its own.
    pub followed: Node,
}

impl LoopNodes {
    /// Returns controller and drive, in this order.
    pub fn both(&self) -> [&Node; 2] {
        [&self.controller, &self.drive]
    }

    /// Returns the one of them with a part in the loop.
    pub fn of(&self, part: Part) -> Option<&Node> {
        self.both().into_iter().find(|node| node.part == part)
    }
}

/// Nodes of the shipped rig.
impl Default for LoopNodes {
    fn default() -> Self {
        let named = |part: Part, id| Node::new(part.word(), id, part);
        let drive = named(Part::Drive, 0x10);
        Self {
            controller: named(Part::Controller, CONTROLLER_NODE_ID),
            followed: drive.clone(),
            drive,
        }
    }
}
