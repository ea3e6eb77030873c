# syntax=docker/dockerfile:1
# `brickyard serve` and what it needs, nothing else: no OpenVDB, no compiler. docs/deploy.md says how to run it.
#   docker build -f docker/server.Dockerfile -t brickyard-server .
FROM debian:12-slim AS build
WORKDIR /source
# Alone, so that a changed source does not fetch the packages again.
COPY tools/install-packages tools/
RUN tools/install-packages build
COPY . .
RUN --mount=type=cache,target=/root/.cache/ccache \
    tools/build server brickyard \
    && strip -o /brickyard build/server/brickyard

FROM debian:12-slim
# ca-certificates is left out on purpose: the server calls nobody.
RUN apt-get update \
    && apt-get install -y --no-install-recommends \
        libfmt9 libpng16-16 libprotobuf32 libspdlog1.10 libssl3 libstdc++6 libxxhash0 libzstd1 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /brickyard /usr/local/bin/brickyard
COPY LICENSE /usr/share/doc/brickyard/LICENSE
# A library that the list above lacks ends the build here, not the first start.
RUN brickyard serve --help >/dev/null

# A number, so that Kubernetes can tell that it is not root. Nothing is ever written: run with a read-only root.
USER 10001:10001
VOLUME /data
EXPOSE 8750
STOPSIGNAL SIGTERM
# bash speaks TCP by itself. Where the server has a certificate of its own (--tls-cert), give another check.
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 CMD ["/bin/bash", "-c", \
    "exec 3<>/dev/tcp/127.0.0.1/8750 && printf 'GET /healthz HTTP/1.1\\r\\nHost: localhost\\r\\nConnection: close\\r\\n\\r\\n' >&3 && read -r -t 4 line <&3 && [[ $line == *' 200 '* ]]"]
ENTRYPOINT ["brickyard", "serve"]
CMD ["/data", "--listen", "0.0.0.0:8750"]
