//! Atomic writes: files and folders are never left half written or lost, and only regular files are replaced.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Prefix and suffix of the names of files until they are complete.
const UNFINISHED: (&str, &str) = (".lsdc-", ".tmp");
/// Age above which an unfinished file is considered abandoned.
const LONG_AGO: Duration = Duration::from_mins(10);

/// Writes `path` through a temporary file, renamed when complete, as [`AtomicFile`]. On return the file is safe from a
/// power failure.
///
/// # Errors
/// The folder cannot be written, or `fill` fails; `path` is then untouched.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> Result<()> {
    let mut file = AtomicFile::create(path)?;
    let mut buffer = BufWriter::new(&mut file);
    fill(&mut buffer)
        .and_then(|()| buffer.flush())
        .map_err(|e| Error::write(path, e))?;
    drop(buffer);
    file.finish()
}

/// A temporary file that is moved to a path, or copied into the pipe or device there. It is removed unless finished.
#[derive(Debug)]
pub struct AtomicFile {
    file: tempfile::NamedTempFile,
    target: Target,
}

impl AtomicFile {
    /// Creates the temporary file of `path` in the folder of its target, following links.
    ///
    /// # Errors
    /// The folder cannot be written, or `path` is a folder.
    pub fn create(path: &Path) -> Result<Self> {
        let attempt = || {
            let target = Target::of(path)?;
            let file = match &target {
                Target::File(path) => temporary(parent(path))?,
                Target::Stream(_) => temporary(&std::env::temp_dir())?,
            };
            Ok(Self { file, target })
        };
        attempt().map_err(|e| Error::write(path, e))
    }

    /// Moves the file to its path, replacing an existing file, or copies it into the pipe or device there. On return the
    /// file is safe from a power failure.
    ///
    /// # Errors
    /// The file cannot be written; an existing one is then untouched.
    pub fn finish(self) -> Result<()> {
        let Self { mut file, target } = self;
        match &target {
            Target::File(path) => {
                let renamed = file.as_file().sync_all().and_then(|()| {
                    file.persist(path).map_err(|e| e.error)?;
                    sync_folder(parent(path))
                });
                renamed.map_err(|e| Error::write(path, e))
            }
            Target::Stream(path) => {
                let mut copy = || {
                    let mut stream = File::options().append(true).open(path)?;
                    file.rewind()?;
                    std::io::copy(&mut file, &mut stream).map(|_| ())
                };
                copy().map_err(|e| Error::write(path, e))
            }
        }
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, position: SeekFrom) -> std::io::Result<u64> {
        self.file.seek(position)
    }
}

/// Makes `target` a hard link to the file at `source`, or a copy if the file system does not support links. A file at
/// `target` is replaced as by [`write_atomically`].
///
/// # Errors
/// The file cannot be read, or the target cannot be written.
pub(crate) fn link_or_copy(source: &Path, target: &Path) -> Result<()> {
    // Linking a symbolic link would copy the link, which may be relative.
    let source = source.canonicalize().map_err(|e| Error::read(source, e))?;
    let linked = tempfile::Builder::new()
        .prefix(UNFINISHED.0)
        .suffix(UNFINISHED.1)
        .make_in(parent(target), |path| std::fs::hard_link(&source, path));
    if let Ok(link) = linked
        && link.persist(target).is_ok()
    {
        return Ok(());
    }
    let mut file = File::open(&source).map_err(|e| Error::read(&source, e))?;
    write_atomically(target, |out| std::io::copy(&mut file, out).map(|_| ()))
}

/// The target of a path, following links.
#[derive(Debug, PartialEq, Eq)]
enum Target {
    /// A regular file, which need not exist.
    File(PathBuf),
    /// A pipe, a device or the like, which is written to and never replaced.
    Stream(PathBuf),
}

impl Target {
    fn of(path: &Path) -> std::io::Result<Self> {
        let end = followed(path)?;
        match end.metadata() {
            Ok(found) if found.is_dir() => Err(ErrorKind::IsADirectory.into()),
            Ok(found) if !found.is_file() => Ok(Self::Stream(end)),
            Ok(_) if end.is_symlink() => Err(std::io::Error::new(
                ErrorKind::InvalidInput,
                "it is an open file of a process: give its name instead",
            )),
            Ok(_) => Ok(Self::File(end)),
            Err(e) if e.kind() == ErrorKind::NotFound => Ok(Self::File(end)),
            Err(e) => Err(e),
        }
    }
}

/// Follows links until the path is not a link, or is one of the open files of a process, as for `/dev/stdout`.
fn followed(path: &Path) -> std::io::Result<PathBuf> {
    /// Limit above that of any system.
    const MOST_LINKS: usize = 64;
    let mut end = path.to_owned();
    for _ in 0..MOST_LINKS {
        match end.read_link() {
            Ok(link) if !of_a_process(parent(&end)) => end = parent(&end).join(link),
            _ => return Ok(end),
        }
    }
    Err(std::io::Error::other("the links lead in a circle"))
}

/// Whether the links of a folder are the open files of a process.
fn of_a_process(folder: &Path) -> bool {
    cfg!(target_os = "linux") && folder.canonicalize().is_ok_and(|p| p.starts_with("/proc"))
}

/// Returns whether writing to `path` replaces something: a file, or a dangling link. Pipes and devices are written to, not
/// replaced.
pub fn would_replace(path: &Path) -> bool {
    !matches!(Target::of(path), Ok(Target::Stream(_))) && path.symlink_metadata().is_ok()
}

/// Checks, before computing anything, that `path` can be written without replacing anything, unless `force` allows it.
/// Leaves nothing behind.
///
/// # Errors
/// A file or link exists and `force` is not set, or `path` cannot be written.
pub fn check_output(path: &Path, force: bool) -> Result<()> {
    if !force && would_replace(path) {
        return Err(Error::config(format!("`{}` exists", path.display()))
            .hint("give --force to replace it"));
    }
    match Target::of(path).map_err(|e| Error::write(path, e))? {
        Target::File(file) => check_writable(parent(&file)),
        Target::Stream(_) => Ok(()),
    }
}

/// Writes the folder `path` through a temporary one beside it, renamed when complete. `fill` gets the temporary folder and
/// writes its files by [`write_atomically`]. A folder at `path` is renamed before it is removed, so that one of the two is
/// complete at any time.
///
/// # Errors
/// The folder cannot be written, `path` is not a folder, or `fill` fails; an existing folder is then untouched.
pub fn write_folder_atomically(path: &Path, fill: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let failed = |e| Error::write(path, e);
    let path = followed(path).map_err(failed)?;
    if path.symlink_metadata().is_ok_and(|found| !found.is_dir()) {
        return Err(failed(ErrorKind::NotADirectory.into()));
    }
    let folder = parent(&path);
    std::fs::create_dir_all(folder).map_err(failed)?;
    let filled = temporary_folder(folder).map_err(failed)?;
    fill(filled.path())?;
    let attempt = || {
        let old = temporary_folder(folder)?;
        let before = old.path().join("before");
        let replaces = match std::fs::rename(&path, &before) {
            Ok(()) => true,
            Err(e) if e.kind() == ErrorKind::NotFound => false,
            Err(e) => return Err(e),
        };
        if let Err(e) = std::fs::rename(filled.path(), &path) {
            if replaces && std::fs::rename(&before, &path).is_err() {
                // This is the only copy, so it is kept in the temporary folder.
                let _ = old.keep();
            }
            return Err(e);
        }
        sync_folder(folder)
    };
    attempt().map_err(failed)
}

/// Checks that files can be written into a folder, or into its nearest existing parent. Leaves nothing behind.
///
/// # Errors
/// No file can be written.
pub fn check_writable(folder: &Path) -> Result<()> {
    let nearest = folder
        .ancestors()
        .find(|path| path.exists())
        .unwrap_or(Path::new("."));
    temporary(nearest)
        .map(|_| ())
        .map_err(|e| Error::write(folder, e).hint("give another folder with -o"))
}

fn temporary(folder: &Path) -> std::io::Result<tempfile::NamedTempFile> {
    tempfile::Builder::new()
        .prefix(UNFINISHED.0)
        .suffix(UNFINISHED.1)
        .permissions_like_a_new_file(0o666)
        .tempfile_in(folder)
}

fn temporary_folder(folder: &Path) -> std::io::Result<tempfile::TempDir> {
    tempfile::Builder::new()
        .prefix(UNFINISHED.0)
        .suffix(UNFINISHED.1)
        .permissions_like_a_new_file(0o777)
        .tempdir_in(folder)
}

fn parent(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Makes the names in a folder safe from a power failure, if the file system supports it.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> std::io::Result<()> {
    use ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // A folder that may be written but not listed cannot be opened.
        Err(e) if matches!(e.kind(), InvalidInput | PermissionDenied | Unsupported) => Ok(()),
        result => result,
    }
}

/// Folders cannot be opened as files here; the system syncs their names.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> std::io::Result<()> {
    Ok(())
}

/// Removes unfinished files that killed programs left in a folder. Errors are ignored.
pub fn remove_leftovers(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        let unfinished = name.starts_with(UNFINISHED.0) && name.ends_with(UNFINISHED.1);
        let written = entry.metadata().and_then(|found| found.modified());
        let old = || {
            let age = written.ok().and_then(|time| time.elapsed().ok());
            age.is_some_and(|age| age > LONG_AGO)
        };
        if unfinished && old() {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Permissions of output files. A temporary file is private by default; an output should be as readable as any other file.
trait LikeANewFile {
    fn permissions_like_a_new_file(&mut self, mode: u32) -> &mut Self;
}

impl LikeANewFile for tempfile::Builder<'_, '_> {
    #[cfg(unix)]
    fn permissions_like_a_new_file(&mut self, mode: u32) -> &mut Self {
        use std::os::unix::fs::PermissionsExt as _;
        self.permissions(std::fs::Permissions::from_mode(mode))
    }

    #[cfg(not(unix))]
    fn permissions_like_a_new_file(&mut self, _: u32) -> &mut Self {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_was_left_long_ago_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let names = [".lsdc-old.tmp", ".lsdc-new.tmp", "old.npy"];
        for name in names {
            let file = File::create(folder.path().join(name)).unwrap();
            if name.contains("old") {
                let before = std::time::SystemTime::now() - 2 * LONG_AGO;
                file.set_modified(before).unwrap();
            }
        }
        remove_leftovers(folder.path());
        let left = names.map(|name| folder.path().join(name).exists());
        assert_eq!(left, [false, true, true]);
    }

    #[test]
    fn a_folder_appears_when_it_is_complete() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("00000010");
        let fill = |text: &'static [u8]| {
            move |folder: &Path| write_atomically(&folder.join("a"), |out| out.write_all(text))
        };
        write_folder_atomically(&path, fill(b"old")).unwrap();
        let failed = write_folder_atomically(&path, |folder| {
            fill(b"new")(folder)?;
            Err(Error::config("full"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read(path.join("a")).unwrap(), b"old");
        // Leftovers of the failure do no harm.
        write_folder_atomically(&path, fill(b"new")).unwrap();
        assert_eq!(std::fs::read(path.join("a")).unwrap(), b"new");
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 1);
        // A folder does not replace a file.
        assert!(write_folder_atomically(&path.join("a"), |_| Ok(())).is_err());
        assert_eq!(std::fs::read(path.join("a")).unwrap(), b"new");
    }

    #[test]
    fn folders_whose_names_differ_behind_a_point_do_not_share_a_temporary_one() {
        let root = tempfile::tempdir().unwrap();
        let fill = |folder: &Path| write_atomically(&folder.join("x"), |out| out.write_all(b"1"));
        write_folder_atomically(&root.path().join("a.1"), |one| {
            write_folder_atomically(&root.path().join("a.2"), fill)?;
            fill(one)
        })
        .unwrap();
        for name in ["a.1/x", "a.2/x"] {
            assert_eq!(std::fs::read(root.path().join(name)).unwrap(), b"1");
        }
    }

    #[test]
    fn a_file_in_the_place_of_a_folder_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rgb.png");
        std::fs::write(&file, b"image").unwrap();
        check_writable(&folder.path().join("not/yet")).unwrap();
        assert!(check_writable(&file.join("out")).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_failure_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.bin");
        std::fs::write(&path, b"old").unwrap();
        let result = write_atomically(&path, |w| {
            w.write_all(b"new")?;
            Err(std::io::Error::other("full"))
        });
        assert!(result.is_err());
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomically(&path, |w| w.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }

    #[test]
    #[cfg(unix)]
    fn links_stay_and_what_they_lead_to_is_written() {
        use std::os::unix::fs::symlink;
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        for folder in ["links", "files"] {
            std::fs::create_dir(at(folder)).unwrap();
        }
        std::fs::write(at("files/v3"), b"old").unwrap();
        symlink("../files/v3", at("links/latest")).unwrap();
        symlink(at("links/latest"), at("chain")).unwrap();
        symlink("../files/v4", at("links/next")).unwrap();
        symlink("circle", at("circle")).unwrap();

        let failed = write_atomically(&at("chain"), |_| Err(std::io::Error::other("full")));
        assert!(failed.is_err());
        assert_eq!(std::fs::read(at("files/v3")).unwrap(), b"old");
        for (link, file) in [("chain", "files/v3"), ("links/next", "files/v4")] {
            // A link to a file that does not exist yet.
            assert!(would_replace(&at(link)) && check_output(&at(link), false).is_err());
            check_output(&at(link), true).unwrap();
            write_atomically(&at(link), |out| out.write_all(link.as_bytes())).unwrap();
            assert!(at(link).is_symlink());
            assert!(!at(file).is_symlink());
            assert_eq!(std::fs::read(at(file)).unwrap(), link.as_bytes());
        }
        assert!(at("links/latest").is_symlink());
        assert_eq!(std::fs::read_dir(at("files")).unwrap().count(), 2);

        assert!(would_replace(&at("circle")) && check_output(&at("circle"), true).is_err());
        assert!(write_atomically(&at("circle"), |_| Ok(())).is_err());
        assert!(at("circle").is_symlink());

        symlink("files", at("folder")).unwrap();
        assert!(check_output(&at("folder"), true).is_err());
        assert!(write_atomically(&at("folder"), |_| Ok(())).is_err());
        assert!(!would_replace(&at("new")) && check_output(&at("new"), false).is_ok());
    }

    #[test]
    #[cfg(unix)]
    fn a_folder_behind_a_link_is_replaced_and_the_link_stays() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        std::fs::create_dir(at("run")).unwrap();
        std::fs::write(at("run/old"), b"old").unwrap();
        std::os::unix::fs::symlink("run", at("latest")).unwrap();
        let fill = |folder: &Path| write_atomically(&folder.join("x"), |out| out.write_all(b"1"));
        write_folder_atomically(&at("latest"), fill).unwrap();
        assert!(at("latest").is_symlink() && at("run/x").exists() && !at("run/old").exists());
        assert_eq!(std::fs::read_dir(root.path()).unwrap().count(), 2);
    }

    /// Whether a system command succeeds.
    #[cfg(unix)]
    fn runs(command: &str, arguments: &[&str], path: &Path) -> bool {
        let status = std::process::Command::new(command)
            .arg(path)
            .args(arguments)
            .stderr(std::process::Stdio::null())
            .status();
        status.is_ok_and(|status| status.success())
    }

    #[test]
    #[cfg(unix)]
    fn a_pipe_is_written_to_and_stays_also_behind_a_link() {
        use std::os::unix::fs::FileTypeExt as _;
        let folder = tempfile::tempdir().unwrap();
        let (pipe, link) = (folder.path().join("pipe"), folder.path().join("link"));
        assert!(runs("mkfifo", &[], &pipe));
        std::os::unix::fs::symlink("pipe", &link).unwrap();
        for path in [&pipe, &link] {
            assert!(!would_replace(path));
            check_output(path, false).unwrap();
            let reader = std::thread::spawn({
                let pipe = pipe.clone();
                move || std::fs::read(pipe).unwrap()
            });
            let mut file = AtomicFile::create(path).unwrap();
            file.write_all(b"?ello").unwrap();
            file.rewind().unwrap();
            file.write_all(b"h").unwrap();
            file.finish().unwrap();
            assert_eq!(reader.join().unwrap(), b"hello");
        }
        // Nothing is written if writing the contents fails.
        assert!(write_atomically(&pipe, |_| Err(std::io::Error::other("full"))).is_err());
        assert!(pipe.metadata().unwrap().file_type().is_fifo() && link.is_symlink());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_device_is_written_to_and_stays() {
        use std::os::unix::fs::FileTypeExt as _;
        let folder = tempfile::tempdir().unwrap();
        // A separate null device, if the system allows creating one.
        let null = folder.path().join("null");
        if !runs("mknod", &["c", "1", "3"], &null)
            || File::options().append(true).open(&null).is_err()
        {
            return;
        }
        check_output(&null, false).unwrap();
        write_atomically(&null, |out| out.write_all(b"gone")).unwrap();
        assert!(null.metadata().unwrap().file_type().is_char_device());
        assert_eq!(std::fs::read(&null).unwrap(), b"");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn an_open_file_of_a_process_is_not_replaced() {
        use std::os::fd::AsRawFd as _;
        let folder = tempfile::tempdir().unwrap();
        let file = File::create(folder.path().join("out")).unwrap();
        let path = PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()));
        assert!(check_output(&path, true).is_err());
        assert!(write_atomically(&path, |out| out.write_all(b"x")).is_err());
        assert_eq!(file.metadata().unwrap().len(), 0);
    }
}
