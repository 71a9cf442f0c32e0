//! Layout of the cache, and its location from the environment.

use super::HubModel;
use super::download::{HubClient, checksum_of};
use crate::NetsError;
use sms_core::{Cancel, CoreError, InputError, Progress};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Location of the hub and its cache.
#[derive(Clone)]
pub struct HubConfig {
    /// Address of the hub (`HF_ENDPOINT`).
    pub endpoint: String,
    /// The cache (`HF_HUB_CACHE`, or `hub` in `HF_HOME`).
    pub cache: PathBuf,
    /// Token for repositories that require one (`HF_TOKEN`, or the file `token` in `HF_HOME`). Never shown.
    pub token: Option<String>,
    /// Whether network access is forbidden (`HF_HUB_OFFLINE`).
    pub is_offline: bool,
    /// Branch, tag or commit that replaces the pinned one of each model ([`HubModel::revision`]).
    pub revision: Option<String>,
    /// Greatest number of attempts of a download.
    pub attempts: usize,
    /// Pause before the second attempt, doubled each time; a pause requested by the server takes precedence.
    pub pause: Duration,
}

impl std::fmt::Debug for HubConfig {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("HubConfig")
            .field("endpoint", &self.endpoint)
            .field("cache", &self.cache)
            .field("has_token", &self.token.is_some())
            .field("is_offline", &self.is_offline)
            .field("revision", &self.revision)
            .finish_non_exhaustive()
    }
}

/// A model in the cache.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CachedModel {
    /// The commit.
    pub commit: String,
    /// The folder with its files.
    pub folder: PathBuf,
}

impl HubConfig {
    /// Reads the environment like the hub's own library.
    pub fn from_environment() -> Self {
        Self::from_variables(|name| std::env::var(name).ok())
    }

    /// Reads the settings from these variables.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Self {
        let set = |name: &str| variable(name).map(|v| v.trim().to_owned()).filter(|v| !v.is_empty());
        let user = || set("HOME").or_else(|| set("USERPROFILE")).unwrap_or_else(|| ".".into());
        let home = set("HF_HOME").map(PathBuf::from).unwrap_or_else(|| {
            let base = set("XDG_CACHE_HOME").map_or_else(|| Path::new(&user()).join(".cache"), PathBuf::from);
            base.join("huggingface")
        });
        let stored = || std::fs::read_to_string(home.join("token")).ok().map(|t| t.trim().to_owned());
        let is_on = |v: String| matches!(v.to_ascii_lowercase().as_str(), "1" | "on" | "yes" | "true");
        Self {
            endpoint: set("HF_ENDPOINT")
                .map_or_else(|| "https://huggingface.co".into(), |e| e.trim_end_matches('/').to_owned()),
            cache: set("HF_HUB_CACHE").map_or_else(|| home.join("hub"), PathBuf::from),
            token: set("HF_TOKEN").or_else(stored).filter(|t| !t.is_empty()),
            is_offline: set("HF_HUB_OFFLINE").is_some_and(is_on),
            revision: None,
            attempts: 5,
            pause: Duration::from_secs(1),
        }
    }

    /// Returns the branch, tag or commit of a model.
    pub(crate) fn revision<'a>(&'a self, model: &'a HubModel) -> &'a str {
        self.revision.as_deref().unwrap_or(model.revision)
    }

    /// Returns a model's folder in the cache.
    pub(crate) fn repository(&self, model: &HubModel) -> PathBuf {
        self.cache.join(format!("models--{}", model.repository.replace('/', "--")))
    }

    /// Returns the model if all of its files are in the cache.
    pub fn cached(&self, model: &HubModel) -> Option<CachedModel> {
        let repository = self.repository(model);
        let revision = self.revision(model);
        let commit = if is_commit(revision) {
            revision.to_owned()
        } else {
            std::fs::read_to_string(repository.join("refs").join(revision)).ok()?.trim().to_owned()
        };
        let folder = repository.join("snapshots").join(&commit);
        let is_whole = model.files.iter().all(|f| folder.join(f).is_file());
        is_whole.then_some(CachedModel { commit, folder })
    }

    /// Returns the folder with the model's files, and downloads those that are not in the cache.
    ///
    /// # Errors
    /// [`NetsError::Input`] with the reason, the files to fetch and their place; [`NetsError::Core`] for files and
    /// interruption.
    pub fn fetch(
        &self,
        model: &HubModel,
        progress: &dyn Progress,
        cancel: &Cancel,
    ) -> Result<PathBuf, NetsError> {
        if let Some(cached) = self.cached(model) {
            return Ok(cached.folder);
        }
        if self.is_offline {
            let what =
                format!("the model {} is not in the cache, and HF_HUB_OFFLINE is set", model.repository);
            return Err(InputError::new(what, self.repository(model), self.by_hand(model)).into());
        }
        let client = HubClient::new(self, model);
        let repository = self.repository(model);
        let asked = self.revision(model);
        let mut revision = asked.to_owned();
        for file in model.files {
            cancel.check()?;
            let remote = client.look(&revision, file, cancel)?;
            if is_commit(&revision) && remote.commit != revision {
                let what = format!(
                    "asked for {file} of {} at commit {revision}, the hub answers with commit {}",
                    model.repository, remote.commit
                );
                let cure = format!("a mirror that ignores commits cannot be used; {}", self.by_hand(model));
                return Err(InputError::new(what, &self.endpoint, cure).into());
            }
            let blob = repository.join("blobs").join(&remote.checksum);
            // Another program, or a full disk, may have left different content under this name.
            if !blob.is_file() || checksum_of(&blob, remote.checksum.len(), cancel)? != remote.checksum {
                client.download(&remote, file, &blob, progress, cancel)?;
            }
            // All files of one model come from one commit, even if the branch moves meanwhile.
            revision.clone_from(&remote.commit);
            link(&blob, &repository.join("snapshots").join(&remote.commit).join(file))?;
        }
        if revision != asked {
            // Written last: this marks the model as cached.
            sms_core::atomic::write_bytes(&repository.join("refs").join(asked), revision.as_bytes())?;
        }
        Ok(repository.join("snapshots").join(&revision))
    }

    /// Returns the instructions for fetching a model by hand.
    pub(crate) fn by_hand(&self, model: &HubModel) -> String {
        format!(
            "fetch {} from https://huggingface.co/{} on a machine that can, put them into a folder and give it with \
             --weights DIR",
            model.files.join(", "),
            model.repository
        )
    }
}

/// Returns whether a revision is a commit instead of a branch or tag.
fn is_commit(revision: &str) -> bool {
    revision.len() == 40 && revision.bytes().all(|b| b.is_ascii_hexdigit())
}

/// Makes `at` a link to the file `blob` in the folder `blobs` two levels up.
fn link(blob: &Path, at: &Path) -> Result<(), CoreError> {
    if let Some(folder) = at.parent() {
        std::fs::create_dir_all(folder).map_err(CoreError::write(folder))?;
    }
    if at.is_file() {
        return Ok(());
    }
    // Removes a dangling link.
    let _ = std::fs::remove_file(at);
    #[cfg(unix)]
    {
        let name = blob.file_name().unwrap_or_default();
        let target = Path::new("../../blobs").join(name);
        if std::os::unix::fs::symlink(&target, at).is_ok() && at.is_file() {
            return Ok(());
        }
        let _ = std::fs::remove_file(at);
    }
    std::fs::copy(blob, at).map(drop).map_err(CoreError::write(at))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(pairs: &[(&str, &str)]) -> HubConfig {
        HubConfig::from_variables(|name| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned()))
    }

    #[test]
    fn the_environment_is_read_as_the_hubs_library_reads_it() {
        let hub = of(&[("HOME", "/u")]);
        assert_eq!(hub.cache, Path::new("/u/.cache/huggingface/hub"));
        assert_eq!(hub.endpoint, "https://huggingface.co");
        assert!(!hub.is_offline && hub.token.is_none());
        assert_eq!(of(&[("HF_HOME", "/h")]).cache, Path::new("/h/hub"));
        assert_eq!(of(&[("XDG_CACHE_HOME", "/x")]).cache, Path::new("/x/huggingface/hub"));
        assert_eq!(of(&[("HF_HOME", "/h"), ("HF_HUB_CACHE", "/c")]).cache, Path::new("/c"));
        assert_eq!(of(&[("HF_ENDPOINT", "http://mirror/")]).endpoint, "http://mirror");
        assert!(of(&[("HF_HUB_OFFLINE", "YES")]).is_offline && !of(&[("HF_HUB_OFFLINE", "0")]).is_offline);
        let secret = "hf_secret";
        let hub = of(&[("HF_TOKEN", " hf_secret\n")]);
        assert_eq!(hub.token.as_deref(), Some(secret));
        assert!(!format!("{hub:?}").contains(secret));
    }
}
