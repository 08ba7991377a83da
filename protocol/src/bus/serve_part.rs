//! Part servers. How do all asks of one part reach its core, and the replies their askers? By the part's rows of the key table: each
//! ask has a server and a bounded queue of its own, so that a flood of one ask never holds up another (a stop).

use std::fmt;
use std::pin::Pin;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Bus, BusError, Server};
use crate::messages::Refusal;
use crate::topics::{Ask, AskVisitor, PartAsks};

/// A request in the type of the part's core, and the way back to its asker.
#[derive(Debug)]
pub struct Call<P: PartAsks> {
    /// What is asked.
    pub request: P,
    /// Where the reply goes.
    pub responder: Responder<P>,
}

/// The way back to an asker. Dropped without a reply the request counts as not heard: the asker asks again until its deadline.
pub struct Responder<P: PartAsks>(Box<dyn FnOnce(Result<P::Reply, Refusal>) + Send + Sync>);

impl<P: PartAsks> Responder<P> {
    /// Replies or refuses.
    pub fn send(self, reply: Result<P::Reply, Refusal>) {
        (self.0)(reply);
    }
}

impl<P: PartAsks> fmt::Debug for Responder<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Responder")
    }
}

/// Serves one ask of a part.
pub struct PartServer<P: PartAsks>(Box<dyn Serves<P>>);

impl<P: PartAsks> PartServer<P> {
    /// Waits for the next request; `None` when the bus was closed. What cannot be read is refused here with the reason.
    pub async fn next(&mut self) -> Option<Call<P>> {
        self.0.next().await
    }
}

impl<P: PartAsks> fmt::Debug for PartServer<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("PartServer")
    }
}

impl Bus {
    /// Serves every ask of a part under these chunks, each by a server of its own.
    ///
    /// # Errors
    /// As [`Bus::serve`].
    pub fn serve_part<P: PartAsks>(&self, chunks: &[&str]) -> Result<Vec<PartServer<P>>, BusError> {
        let mut declaring = Declaring {
            bus: self,
            chunks,
            servers: Vec::new(),
        };
        P::visit(&mut declaring)?;
        Ok(declaring.servers)
    }
}

/// Declares a server for each ask that it is shown.
struct Declaring<'a, P: PartAsks> {
    bus: &'a Bus,
    chunks: &'a [&'a str],
    servers: Vec<PartServer<P>>,
}

impl<P: PartAsks> AskVisitor<P> for Declaring<'_, P> {
    type Error = BusError;

    fn visit<Q, R>(
        &mut self,
        ask: Ask<Q, R>,
        request: fn(Q) -> P,
        reply: fn(P::Reply) -> Option<R>,
    ) -> Result<(), BusError>
    where
        Q: DeserializeOwned + Clone + Send + Sync + 'static,
        R: Serialize + Send + Sync + 'static,
    {
        let server = self.bus.serve(&ask, self.chunks)?;
        self.servers
            .push(PartServer(Box::new(Serving { server, request, reply })));
        Ok(())
    }
}

type Next<'a, P> = Pin<Box<dyn Future<Output = Option<Call<P>>> + Send + 'a>>;

/// A server whose request and reply types are not told apart any more.
trait Serves<P: PartAsks>: Send {
    fn next(&mut self) -> Next<'_, P>;
}

struct Serving<P: PartAsks, Q, R> {
    server: Server<Q, R>,
    request: fn(Q) -> P,
    reply: fn(P::Reply) -> Option<R>,
}

impl<P, Q, R> Serves<P> for Serving<P, Q, R>
where
    P: PartAsks,
    Q: DeserializeOwned + Clone + Send + Sync + 'static,
    R: Serialize + Send + Sync + 'static,
{
    fn next(&mut self) -> Next<'_, P> {
        Box::pin(async {
            let asked = self.server.next().await?;
            let (request, reply) = ((self.request)(asked.body.clone()), self.reply);
            let respond = move |answer: Result<P::Reply, Refusal>| match answer.map(reply) {
                Ok(Some(reply)) => asked.reply(&reply),
                Ok(None) => asked.refuse(&Refusal::Internal {
                    reason: "the reply is one to another ask".to_owned(),
                }),
                Err(refusal) => asked.refuse(&refusal),
            };
            Some(Call {
                request,
                responder: Responder(Box::new(respond)),
            })
        })
    }
}
