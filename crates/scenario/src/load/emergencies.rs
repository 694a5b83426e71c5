//! The nodes whose emergencies are expected of a loop: a scenario on a rig may call them as the rig does.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::sections::{CONTROLLER, Selector};
use crate::error::Problem;
use crate::nearest::meant_or_known;
use crate::rig::nodes::NodeKind;

const EMERGENCY: &str = "emcy";
/// What an expectation calls the nodes of its loop.
const DRIVE: &str = "drive";
const DISTURBANCE: &str = "disturbance";

impl<'text> Selector<'_, 'text> {
    /// Calls the nodes of `emcy`, in a loop's limits and in its sequences, as expectations do.
    pub(super) fn name_emergencies(
        &self,
        expect: &mut DeTable<'text>,
        of_loop: &str,
    ) -> Result<(), Problem> {
        for (key, value) in expect.iter_mut() {
            let is_emergency = key.get_ref() == EMERGENCY;
            match value.get_mut() {
                DeValue::String(_) if is_emergency => self.name_emergency(value, of_loop)?,
                DeValue::Array(entries) => {
                    for entry in entries.iter_mut() {
                        match entry.get_mut() {
                            DeValue::String(_) if is_emergency => {
                                self.name_emergency(entry, of_loop)?;
                            }
                            DeValue::Table(below) => self.name_emergencies(below, of_loop)?,
                            _ => {}
                        }
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// `left 0x8130` is `drive 0x8130` of the loop whose drive is `left`. What has another form is refused later.
    fn name_emergency(
        &self,
        text: &mut Spanned<DeValue<'text>>,
        of_loop: &str,
    ) -> Result<(), Problem> {
        let written = text.get_ref().as_str().unwrap_or_default();
        let Some((name, code)) = written.split_once(' ') else {
            return Ok(());
        };
        let roles = [CONTROLLER, DRIVE, DISTURBANCE];
        let Some(node) = self.rig.node.get(name) else {
            if roles.contains(&name) {
                return Ok(());
            }
            let known = Vec::from_iter(self.rig.node.keys().map(String::as_str));
            let message = format!("the rig has no node `{name}`");
            let label = meant_or_known(name, &known);
            return Err(self.scenario.source.problem(text.span(), message, label));
        };
        let drive = self.drive(of_loop);
        let role = match node.kind {
            NodeKind::Controller => CONTROLLER,
            NodeKind::Drive if name == drive => DRIVE,
            NodeKind::Io if self.rig.acts_on(name, drive) => DISTURBANCE,
            NodeKind::Drive | NodeKind::Io => {
                let message = format!("`{name}` is no node of the loop `{of_loop}`");
                let label = format!("its drive is `{drive}`");
                return Err(self.scenario.source.problem(text.span(), message, label));
            }
        };
        let renamed = format!("{role} {code}");
        *text.get_mut() = DeValue::String(renamed.into());
        Ok(())
    }
}
