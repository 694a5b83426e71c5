//! Attributes of an element, with errors that name its line.

use std::fmt;

use roxmltree::Node;
use serde::Deserialize;

use super::variable::keyword;
use crate::error::Fault;

/// An element's attributes.
#[derive(Clone, Copy)]
pub(super) struct Attributes<'a, 'input>(pub(super) Node<'a, 'input>);

impl<'a> Attributes<'a, '_> {
    /// Returns an error for the element.
    pub(super) fn fault(&self, reason: impl fmt::Display) -> Fault {
        let line = self.0.document().text_pos_at(self.0.range().start).row;
        Fault::Invalid(format!("modelDescription.xml, line {line}: {reason}"))
    }

    pub(super) fn text(&self, name: &str) -> Option<&'a str> {
        self.0.attribute(name)
    }

    /// Returns a text on one line.
    pub(super) fn owned(&self, name: &str) -> String {
        on_one_line(self.text(name).unwrap_or_default())
    }

    pub(super) fn required(&self, name: &str) -> Result<&'a str, Fault> {
        let element = self.0.tag_name().name();
        let text = self.text(name).filter(|text| !text.is_empty());
        text.ok_or_else(|| self.fault(format!("<{element}> has no `{name}`")))
    }

    /// Returns a name. Line ends and tabs in it become spaces, by FMI's type for names, `normalizedString`.
    pub(super) fn name(&self, attribute: &str) -> Result<String, Fault> {
        self.required(attribute).map(on_one_line)
    }

    pub(super) fn is_true(&self, name: &str) -> Result<bool, Fault> {
        match self.text(name).map(str::trim) {
            None | Some("false" | "0") => Ok(false),
            Some("true" | "1") => Ok(true),
            Some(other) => Err(self.fault(format!("`{name}` is `{other}`, not true or false"))),
        }
    }

    /// Returns a finite number; `None` for a missing attribute, and for INF, by which FMI marks an absent limit.
    pub(super) fn number(&self, name: &str) -> Result<Option<f64>, Fault> {
        let Some(text) = self.text(name) else {
            return Ok(None);
        };
        let text = text.trim();
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(Some(value)),
            Ok(_) => Ok(None),
            Err(_) => Err(self.fault(format!("`{name}` is `{text}`, not a number"))),
        }
    }

    /// Returns one of several keywords.
    pub(super) fn word<T: Deserialize<'a>>(&self, name: &str) -> Result<Option<T>, Fault> {
        let Some(text) = self.text(name) else {
            return Ok(None);
        };
        let word = keyword(text);
        let unknown = || self.fault(format!("`{name}` cannot be `{text}`"));
        word.ok_or_else(unknown).map(Some)
    }

    /// Returns the elements of a name below this one.
    pub(super) fn children(&self, name: &'static str) -> impl Iterator<Item = Self> {
        self.elements()
            .filter(move |child| child.0.tag_name().name() == name)
    }

    pub(super) fn child(&self, name: &'static str) -> Option<Self> {
        self.children(name).next()
    }

    /// Returns all elements below this one.
    pub(super) fn elements(&self) -> impl Iterator<Item = Self> {
        self.0.children().filter(Node::is_element).map(Self)
    }
}

fn on_one_line(text: &str) -> String {
    text.replace(['\n', '\r', '\t'], " ")
}
