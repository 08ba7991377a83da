//! Component servers. How do all asks of one component reach its core, and how do the replies return? From the component's rows of the key
//! table: each ask has its own server and bounded queue, so that a flood of one ask never delays another (a stop).

use std::collections::BTreeMap;
use std::fmt;
use std::pin::Pin;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::{Bus, BusError, Server};
use crate::messages::Refusal;
use crate::topics::{Ask, AskVisitor, PartAsks};

/// A request in the core's own type, and the responder to its client.
#[derive(Debug)]
pub struct Call<P: PartAsks> {
    /// What the client asked, in the core's own type.
    pub request: P,
    /// Responder for the reply.
    pub responder: Responder<P>,
}

/// Sends the reply to the client. If it is dropped without a reply, the client repeats its request until its deadline.
pub struct Responder<P: PartAsks> {
    /// Parameters of the selector: `format` is `png` in `map?format=png`.
    pub parameters: BTreeMap<String, String>,
    respond: Box<dyn FnOnce(Result<Body<P>, Refusal>) + Send + Sync>,
}

/// What a reply carries.
enum Body<P: PartAsks> {
    Message(P::Reply),
    /// With their media type.
    Bytes(Vec<u8>, &'static str),
}

impl<P: PartAsks> Responder<P> {
    /// Sends the reply or the refusal; there is only one.
    pub fn send(self, reply: Result<P::Reply, Refusal>) {
        (self.respond)(reply.map(Body::<P>::Message));
    }

    /// Sends bytes of any encoding, such as `image/png`, as the reply.
    pub fn send_bytes(self, bytes: Vec<u8>, mime: &'static str) {
        (self.respond)(Ok(Body::Bytes(bytes, mime)));
    }
}

impl<P: PartAsks> fmt::Debug for Responder<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Responder")
    }
}

/// Serves one ask of a component.
pub struct PartServer<P: PartAsks>(Box<dyn Serves<P>>);

impl<P: PartAsks> PartServer<P> {
    /// Waits for the next request; `None` when the bus was closed. A request that cannot be decoded is refused here, with the reason.
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
    /// Serves every ask of a component under these chunks, each with its own server.
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

/// Declares a server for each visited ask.
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
        Q: DeserializeOwned + Send + Sync + 'static,
        R: Serialize + Send + Sync + 'static,
    {
        let server = self.bus.serve(&ask, self.chunks)?;
        self.servers
            .push(PartServer(Box::new(Serving { server, request, reply })));
        Ok(())
    }
}

type Next<'a, P> = Pin<Box<dyn Future<Output = Option<Call<P>>> + Send + 'a>>;

/// A server with its request and reply types erased.
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
    Q: DeserializeOwned + Send + Sync + 'static,
    R: Serialize + Send + Sync + 'static,
{
    fn next(&mut self) -> Next<'_, P> {
        Box::pin(async {
            let (body, asked) = self.server.next().await?.split();
            let (parameters, reply) = (asked.parameters.clone(), self.reply);
            let respond = move |answer: Result<Body<P>, Refusal>| match answer {
                Ok(Body::Message(message)) => match reply(message) {
                    Some(reply) => asked.reply(&reply),
                    None => asked.refuse(&Refusal::Internal {
                        reason: "the reply is one to another ask".to_owned(),
                    }),
                },
                Ok(Body::Bytes(bytes, mime)) => asked.reply_bytes(bytes, mime),
                Err(refusal) => asked.refuse(&refusal),
            };
            Some(Call {
                request: (self.request)(body),
                responder: Responder {
                    parameters,
                    respond: Box::new(respond),
                },
            })
        })
    }
}
