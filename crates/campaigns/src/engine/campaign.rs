//! A campaign that was handed to an engine: its folder on the disk that all machines share, and what is known of its job, so
//! that whoever watches it may end and begin again.
//!
//! The folder is that of the whole campaign. `engine/` in it has what the engine needs: a copy of this program, so that all
//! machines play with the same one; the job; what the tasks print; and the folders of the parts.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use judge::verdict::Identity;
use plan::Plan;
use recording::run_folder::{RunFolder, WriteError, file};
use runner::play_record::PlayRecord;
use scenario::Override;
use serde::{Deserialize, Serialize};

use super::{EngineKind, Job, Limits};
use crate::sweep::Shard;
use crate::sweep::cases::Cases;
use crate::sweep::part::{folder_id, open_folder};
use crate::sweep::store::{Header, Rows};

/// Folder of the engine's files, in that of the campaign.
const ENGINE: &str = file::ENGINE;
/// The record of the job.
pub(super) const RECORD: &str = "engine/campaign.json";
/// Largest record that is read.
const RECORD_BYTES_MAX: u64 = 16 << 20;
/// The copy of this program.
const PROGRAM: &str = "engine/canrig";
/// What the tasks print.
const LOGS: &str = "engine/log";
/// The folders of the parts.
const PARTS: &str = "engine/parts";
/// The program that runs, also when another file was put in its place meanwhile.
const RUNNING: &str = "/proc/self/exe";

/// What is known of a campaign's job.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Record {
    /// The program that plays it.
    pub(super) program: String,
    pub(super) engine: EngineKind,
    pub(super) parts: usize,
    pub(super) limits: Limits,
    /// How often something was submitted.
    pub(super) rounds: u32,
    /// The job that may still be at work.
    pub(super) job: Option<Submitted>,
}

/// A job that the engine has.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Submitted {
    pub(super) id: String,
    /// The name of its file in `engine/`.
    pub(super) file: String,
    pub(super) parts: Vec<usize>,
}

/// A campaign on the shared disk.
pub(super) struct SharedCampaign<'a> {
    pub(super) cases: &'a dyn Cases,
    pub(super) plan: &'a Plan,
    pub(super) identity: Identity,
    /// Folder in which the campaign's folder is; as every machine of the engine names it.
    pub(super) output: PathBuf,
    /// What a task's command has between the program and the part.
    pub(super) arguments: Vec<String>,
}

impl SharedCampaign<'_> {
    /// Where the campaign's folder is or will be.
    pub(super) fn path(&self) -> PathBuf {
        let id = folder_id(self.cases, Shard::WHOLE);
        RunFolder::path_of(&self.output, &self.plan.shared.run.name, &id)
    }

    /// Makes the folder with all that the tasks need. The program is copied before anything was submitted.
    pub(super) fn prepare(&self, overrides: &[Override]) -> Result<(), WriteError> {
        let folder = self.folder()?;
        if !folder.path().join(file::PLAYED).exists() {
            PlayRecord::now(overrides).write(&folder)?;
        }
        for name in [ENGINE, LOGS, PARTS] {
            let path = folder.path().join(name);
            fs::create_dir_all(&path).map_err(WriteError::at(&path))?;
        }
        let program = folder.path().join(PROGRAM);
        if folder.path().join(RECORD).exists() && program.exists() {
            Ok(())
        } else {
            copy_program(&program).map_err(WriteError::at(&program))
        }
    }

    /// What the record says; none where nothing was submitted.
    pub(super) fn record(&self) -> Result<Option<Record>, io::Error> {
        match scenario::read_text(&self.path().join(RECORD), RECORD_BYTES_MAX) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            text => Ok(Some(serde_json::from_str(&text?)?)),
        }
    }

    /// Writes the record.
    pub(super) fn keep(&self, record: &Record) -> Result<(), WriteError> {
        let text = serde_json::to_string_pretty(record).expect("plain data") + "\n";
        self.folder()?.write(RECORD, text.as_bytes())
    }

    /// Writes the file of a job; its place.
    pub(super) fn write_job(&self, name: &str, text: &str) -> Result<PathBuf, WriteError> {
        self.folder()?
            .write(&format!("{ENGINE}/{name}"), text.as_bytes())?;
        Ok(self.job_file(name))
    }

    /// Where the file of a job is.
    pub(super) fn job_file(&self, name: &str) -> PathBuf {
        self.path().join(ENGINE).join(name)
    }

    fn folder(&self) -> Result<RunFolder, WriteError> {
        open_folder(&self.output, self.plan, self.cases, Shard::WHOLE)
    }

    /// The job of some parts.
    pub(super) fn job<'a>(
        &self,
        folder: &'a Path,
        record: &'a Record,
        parts: &'a [usize],
    ) -> Job<'a> {
        let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
        let mut command = vec![
            path(PROGRAM),
            self.cases.kind().to_owned(),
            path(file::SCENARIO),
        ];
        command.extend(self.arguments.iter().cloned());
        command.extend(["--for-engine", "--quiet", "--threads"].map(str::to_owned));
        command.extend([
            record.limits.cores.to_string(),
            "--output".to_owned(),
            path(PARTS),
        ]);
        // With the number of the round, so that no engine takes it for the one before.
        let name = format!("canrig-{}-{}", self.cases.id(), record.rounds + 1);
        Job {
            name,
            logs: folder.join(LOGS),
            folder,
            command,
            parts,
            of: record.parts,
            limits: &record.limits,
        }
    }

    /// The folder of a part.
    pub(super) fn part(&self, shard: Shard) -> PathBuf {
        let id = folder_id(self.cases, shard);
        RunFolder::path_of(&self.path().join(PARTS), &self.plan.shared.run.name, &id)
    }

    /// The rows of each part, which nobody has read yet.
    pub(super) fn rows(&self, of: usize) -> BTreeMap<usize, Rows> {
        let header = Header::new(self.cases, &self.identity);
        let parts = (1..=of).map(|number| {
            let shard = Shard { number, of };
            (number, Rows::unread(&self.part(shard), &header, shard))
        });
        parts.collect()
    }
}

/// Puts a copy of this program where all machines find it.
fn copy_program(to: &Path) -> io::Result<()> {
    let partial = to.with_added_extension("partial");
    fs::copy(RUNNING, &partial)?;
    fs::set_permissions(&partial, fs::Permissions::from_mode(0o755))?;
    fs::rename(partial, to)
}
