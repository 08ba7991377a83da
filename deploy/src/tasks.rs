//! Tasks. Futures on the heap, without their own types: Tokio's schedulers are compiled once for each type of future that they are given, and
//! every command and part is one.

use std::pin::Pin;

use tokio::runtime::Runtime;
use tokio::task::JoinHandle;

/// Runs a future to its end.
pub(crate) fn block_on<T>(runtime: &Runtime, work: impl Future<Output = T>) -> T {
    let work: Pin<Box<dyn Future<Output = T>>> = Box::pin(work);
    runtime.block_on(work)
}

/// Runs a future beside the current one, as [`tokio::spawn`] does.
pub(crate) fn spawn<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> JoinHandle<T> {
    tokio::spawn(boxed(work))
}

/// A future for [`JoinSet::spawn`](tokio::task::JoinSet::spawn).
pub(crate) fn boxed<T>(work: impl Future<Output = T> + Send + 'static) -> Pin<Box<dyn Future<Output = T> + Send>> {
    Box::pin(work)
}
