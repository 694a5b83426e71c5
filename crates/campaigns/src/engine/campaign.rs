//! A campaign that was handed to an engine: its folder on the disk that all machines share, and the record of its job, with which
//! a watcher may end and begin again.
//!
//! `engine/` in the folder of the campaign has the engine's files: a copy of this program, so that all machines play with the
//! same one; the job; the output of the tasks; and the folders of the parts.

use std::fs::{self, File, Permissions};
use std::io;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;

use recording::run_folder::{RunFolder, WriteError, file};
use runner::exit::Failure;
use runner::play_record::{PlayRecord, read_json};
use scenario::Override;
use serde::{Deserialize, Serialize};

use super::{EngineKind, Job, Limits};
use crate::sweep::Shard;
use crate::sweep::cases::Cases;
use crate::sweep::part::{folder_path, open_folder};
use crate::sweep::store::{Header, Rows};

/// Folder of the engine's files, in the folder of the campaign.
const ENGINE: &str = file::ENGINE;
/// Record of the job.
const RECORD: &str = "engine/campaign.json";
/// Copy of this program.
const PROGRAM: &str = "engine/canrig";
/// Folder of the tasks' output.
const LOGS: &str = "engine/log";
/// Folder of the parts' folders.
const PARTS: &str = "engine/parts";
/// Program that runs, even if its file was replaced meanwhile.
const RUNNING: &str = "/proc/self/exe";

/// Record of a campaign's job.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Record {
    /// Program that plays the campaign.
    pub(super) program: String,
    pub(super) engine: EngineKind,
    pub(super) parts: usize,
    pub(super) limits: Limits,
    /// Number of submissions.
    pub(super) rounds: u32,
    /// Job that may still be running.
    pub(super) job: Option<Submitted>,
}

/// Job in the hands of an engine.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(super) struct Submitted {
    pub(super) id: String,
    /// Name of its file in `engine/`.
    pub(super) file: String,
    pub(super) parts: Vec<usize>,
}

/// Campaign on the shared disk.
pub(super) struct SharedCampaign<'a> {
    pub(super) cases: &'a dyn Cases,
    /// Header of the rows of each part.
    pub(super) header: Header,
    /// Folder in which the campaign's folder is, by the path that every machine of the engine has for it.
    pub(super) output: PathBuf,
    /// Arguments of a task's command between the program and the part.
    pub(super) arguments: Vec<String>,
}

impl SharedCampaign<'_> {
    /// Returns the path of the campaign's folder, which need not exist yet.
    pub(super) fn path(&self) -> PathBuf {
        folder_path(&self.output, self.cases, Shard::WHOLE)
    }

    /// Makes the folder with all files that the tasks need. The program is copied only before the first submission.
    pub(super) fn prepare(&self, overrides: &[Override]) -> Result<(), WriteError> {
        let folder = self.folder()?;
        if !folder.path().join(file::PLAYED).exists() {
            PlayRecord::now(overrides).write(&folder)?;
        }
        for name in [ENGINE, LOGS, PARTS] {
            let path = folder.path().join(name);
            fs::create_dir_all(&path).map_err(WriteError::at(&path))?;
        }
        if [RECORD, PROGRAM]
            .iter()
            .all(|name| folder.path().join(name).exists())
        {
            return Ok(());
        }
        folder.write_with(PROGRAM, |output| {
            io::copy(&mut File::open(RUNNING)?, output)?;
            output
                .get_ref()
                .set_permissions(Permissions::from_mode(0o755))
        })
    }

    /// Reads the record; `None` if no job was submitted.
    pub(super) fn record(&self) -> Result<Option<Record>, Failure> {
        read_json(&self.path(), RECORD)
    }

    pub(super) fn keep(&self, record: &Record) -> Result<(), WriteError> {
        let text = serde_json::to_string_pretty(record).expect("plain data") + "\n";
        self.folder()?.write(RECORD, text.as_bytes())
    }

    /// Writes the file of a job and returns its path.
    pub(super) fn write_job(&self, name: &str, text: &str) -> Result<PathBuf, WriteError> {
        self.folder()?
            .write(&format!("{ENGINE}/{name}"), text.as_bytes())?;
        Ok(self.job_file(name))
    }

    pub(super) fn job_file(&self, name: &str) -> PathBuf {
        self.path().join(ENGINE).join(name)
    }

    fn folder(&self) -> Result<RunFolder, WriteError> {
        open_folder(&self.output, self.cases, Shard::WHOLE)
    }

    /// Returns the job that plays some parts.
    pub(super) fn job<'a>(&self, record: &'a Record, parts: &'a [usize]) -> Job<'a> {
        let folder = self.path();
        let path = |name: &str| folder.join(name).to_string_lossy().into_owned();
        let mut command = vec![
            path(PROGRAM),
            self.cases.facts().kind.to_owned(),
            path(file::SCENARIO),
        ];
        command.extend(self.arguments.iter().cloned());
        command.extend(["--for-engine", "--quiet", "--threads"].map(str::to_owned));
        command.extend([
            record.limits.cores.to_string(),
            "--output".to_owned(),
            path(PARTS),
        ]);
        // The number of the round keeps engines from taking this job for the one before.
        let name = format!("canrig-{}-{}", self.cases.facts().id, record.rounds + 1);
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

    pub(super) fn part(&self, shard: Shard) -> PathBuf {
        folder_path(&self.path().join(PARTS), self.cases, shard)
    }

    /// Reads the rows of each part.
    pub(super) fn rows(&self, of: usize) -> Result<Vec<Rows>, Failure> {
        let parts = (1..=of).map(|number| {
            let shard = Shard { number, of };
            Rows::read(&self.part(shard), &self.header, shard)
        });
        parts.collect()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::path::Path;

    use plan::Plan;
    use scenario::Beside;
    use worlds::catalogue::catalogue;

    use super::*;
    use crate::sweep::sweep_cases::SweepCases;

    /// Returns the plan of a sweep of four runs.
    pub(in crate::engine) fn plan() -> Plan {
        let text = "schema = 1\nrig = \"sma_actuator\"\nname = \"s\"\nduration_seconds = 1.0\n[controller.pid]\n\
            [[reference.hold]]\nat_seconds = 0.0\nposition_millimetres = 10.0\n[sweep]\n\
            [[sweep.list]]\nkey = \"reference.hold[0].position_millimetres\"\nvalues = [5, 15, 25, 35]\n";
        let beside = Beside::new(Path::new("s.toml"));
        Plan::parse_beside(&beside, text.to_owned(), catalogue()).unwrap()
    }

    pub(in crate::engine) fn campaign<'a>(
        cases: &'a dyn Cases,
        output: &Path,
    ) -> SharedCampaign<'a> {
        SharedCampaign {
            cases,
            header: Header::new(cases).unwrap(),
            output: output.to_owned(),
            arguments: Vec::new(),
        }
    }

    #[test]
    fn the_values_of_the_first_command_line_stay_with_the_campaign() {
        let cases = SweepCases::new(&plan()).unwrap();
        let output = tempfile::tempdir().unwrap();
        let campaign = campaign(&cases, output.path());
        for overrides in [vec!["seed=3".parse().unwrap()], vec![]] {
            campaign.prepare(&overrides).unwrap();
            let played = PlayRecord::read(&campaign.path()).unwrap().unwrap();
            assert_eq!(played.set, ["seed=3"]);
        }
    }
}
